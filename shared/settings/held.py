"""The settings that a process runs with, beside those that the unit holds."""

import logging
from collections.abc import Callable

from ..errors import UserError
from ..messages.settings import SettingsState

log = logging.getLogger(__name__)


class HeldSettings:
    """Notices that a process would have other settings if it started again.

    Parameters
    ----------
    digest : str
        Of what the process has read.
    reread : callable
        Reads the vehicle's file again and gives the digest of the same; raises `UserError`.
    """

    def __init__(self, digest: str | None = None, reread: Callable[[], str] | None = None) -> None:
        self.have_changed = False
        self._digest, self._reread = digest, reread

    def note(self, process: str, state: SettingsState) -> bool:
        """Whether the process has to end; not where the file still gives what it has, whatever is announced."""
        announced = state.digests.get(process)
        if self._reread is None or announced is None or announced == self._digest or self.have_changed:
            return self.have_changed
        try:
            self.have_changed = self._reread() != self._digest
        except UserError as error:
            log.warning("other settings are announced, and cannot be read: %s", error)
        if self.have_changed:
            log.info("the settings have changed: ends, and starts again with them")
        return self.have_changed

"""Who this unit is at the centre: its enrolment as it is on the disk, and its renewal in a thread."""

import logging
import threading
from pathlib import Path

from shared.errors import UserError
from shared.evidence.signer import Signer
from shared.fleet.enrolling import renew
from shared.fleet.identity import CENTRE, UplinkIdentity

log = logging.getLogger(__name__)

NS = 1_000_000_000
POLL_PERIOD_NS = 5 * NS
RETRY_NS = 3600 * NS


class Enrolment:
    """The files of the enrolment, read again when they change. Times in ns on the OBU time line."""

    def __init__(self, folder: Path) -> None:
        self.identity: UplinkIdentity | None = None
        self.fault: str | None = None  # why there is no identity
        self.renewals = 0
        self._folder = folder
        self._look_ns = self._renew_ns = 0
        self._failed: tuple[UplinkIdentity, str] | None = None  # a renewal, and why
        self._version: tuple[int, int] | None = None
        self._renewing: threading.Thread | None = None

    @property
    def renewal_fault(self) -> str | None:
        """Why the present certificate is not renewed: a fault of one before an `obu enrol` is none any more."""
        failed = self._failed
        return failed[1] if failed is not None and failed[0] is self.identity else None

    def look(self, now_ns: int) -> UplinkIdentity | None:
        """Give the present enrolment; None, with `fault`, without one."""
        if now_ns < self._look_ns:
            return self.identity
        self._look_ns = now_ns + POLL_PERIOD_NS
        try:
            status = (self._folder / CENTRE).stat()
            version = status.st_ino, status.st_mtime_ns
        except OSError:
            version = None
        if version is None or version != self._version:
            self._read()
            self._version = version if self.identity is not None else None
        return self.identity

    def renew(self, now_ns: int, utc_ns: int, signer: Signer) -> None:
        """Renew the certificate if it is time, in a thread; a failure is told and tried again in an hour."""
        if self._renewing is not None:
            if self._renewing.is_alive():
                return
            self._renewing, self._look_ns = None, 0
        identity = self.identity
        if identity is None or now_ns < self._renew_ns or not identity.renewal_due(utc_ns, signer.key_id):
            return
        self._renew_ns = now_ns + RETRY_NS
        self._renewing = threading.Thread(
            target=self._ask, args=(identity, signer, utc_ns // 1_000_000), name="renewal", daemon=True
        )
        self._renewing.start()

    def _read(self) -> None:
        try:
            self.identity, self.fault = UplinkIdentity.read(self._folder), None
        except UserError as error:
            if str(error) != self.fault:
                log.warning("%s", error)
            self.identity, self.fault = None, str(error)

    def _ask(self, identity: UplinkIdentity, signer: Signer, utc_ms: int) -> None:
        try:
            renew(identity, signer, utc_ms)
        except UserError as error:
            log.warning("the certificate is not renewed: %s", error)
            self._failed = identity, f"the certificate is not renewed: {error}"
            return
        log.info("the certificate of the uplink is renewed")
        self._failed = None
        self.renewals += 1

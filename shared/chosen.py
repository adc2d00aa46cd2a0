"""Which of several devices that measure the same quantity is used: the choice of `controller.mode`, for all processes.

Without a current choice (`controller.mode` is not running, or has not received the devices yet) one rule by silence
holds, which is the same in every process.
"""

from collections.abc import Callable

from .messages.operation import ModeState

SILENCE_TIMEOUT_NS = 5_000_000_000  # silence of the device in use after which another one is used
DECISION_NS = 5_000_000_000  # age after which a choice of `controller.mode`, published each second, is void
NMEA = "/nmea"


def receiver_of(source: str) -> str:
    """Receiver of a source: its UBX and NMEA messages are two sources of one receiver."""
    return source.removesuffix(NMEA)


def gnss_choice(state: ModeState) -> str | None:
    """Source of fixes in use."""
    return state.gnss_source


def receiver_choice(state: ModeState) -> str | None:
    """Receiver of the source of fixes in use."""
    return None if state.gnss_source is None else receiver_of(state.gnss_source)


def imu_choice(state: ModeState) -> str | None:
    """Inertial measurement unit in use."""
    return state.imu_source


def speed_choice(state: ModeState) -> str | None:
    """Source of the speed in use."""
    return state.speed_source


class ChosenSource:
    """The device in use: that of `mode/state`, or of those that are received the first in alphabetical order.

    The rule does not depend on which device was received first, and is the same in every process. Two control units
    that state different speeds (a tractor and its trailer, say) are never mixed.

    Parameters
    ----------
    choice : callable, optional
        What a `ModeState` says of this kind of device; without it the rule by silence always holds.
    silent_ns : int
        [ns] Silence after which another device is used, by the rule.
    """

    def __init__(
        self, choice: Callable[[ModeState], str | None] | None = None, silent_ns: int = SILENCE_TIMEOUT_NS
    ) -> None:
        self._choice, self._silent_ns = choice, silent_ns
        self._decided: str | None = None
        self._decided_ns = 0
        self._source: str | None = None
        self._heard_ns = 0

    def follow(self, state: ModeState) -> None:
        """Take over the choice of `controller.mode`."""
        if self._choice is not None:
            self._decided, self._decided_ns = self._choice(state), state.sampled_ns

    def takes(self, source: str, received_ns: int) -> bool:
        """Note a message of a device; True if it is the one in use."""
        if self._decided is not None and abs(received_ns - self._decided_ns) <= DECISION_NS:
            if source != self._decided:
                return False
        elif self._source is not None and source > self._source and not self._is_silent(received_ns):
            return False
        self._source, self._heard_ns = source, received_ns
        return True

    def current(self, now_ns: int) -> str | None:
        """The device in use; None while it is silent."""
        return None if self._is_silent(now_ns) else self._source

    def _is_silent(self, now_ns: int) -> bool:
        return not 0 <= now_ns - self._heard_ns <= self._silent_ns

"""Tracks the devices from which messages are received, and selects one of each kind by the validity of its messages."""

from collections import deque
from dataclasses import dataclass

from shared.chosen import receiver_of
from shared.messages.operation import SourceSwitch

NS = 1_000_000_000
MAX_SOURCES = 16
VALID_S = 3.0  # since the newest valid message: two of a receiver at 1 Hz may be missed
BETTER_SD_RATIO = 0.5  # share of the selected device's standard deviation below which another one is better
BETTER_FOR_S = 10.0  # for which it must be better, so that a selection does not follow the noise of standard deviations
KEPT_SWITCHES = 4


@dataclass(slots=True)
class Source:
    """What is known of one device."""

    received_ns: int
    rank: int = 0
    valid_ns: int | None = None  # newest valid message
    sd: float | None = None  # [m] as stated last
    better_since_ns: int | None = None  # than the selected one


class Sources:
    """The devices of one kind and the selected one.

    A device remains selected while its messages are valid. Another one is selected if

    - no message has been received for `silent_s`, or none that is valid for `VALID_S` while another device sends some,
    - it states less than half of the standard deviation for `BETTER_FOR_S`,
    - it is a source of the same receiver with a lower rank (UBX before NMEA),
    - the operator wants it, while its messages are valid.

    With `by_name` the first valid one in alphabetical order is selected at any time: which of several control units
    states the speed must not depend on which was received first.
    """

    def __init__(self, silent_s: float, kind: str = "", *, by_name: bool = False) -> None:
        self._silent_ns = round(silent_s * NS)
        self._by_name = by_name
        self._kind = kind
        self._sources: dict[str, Source] = {}
        self.chosen: str | None = None
        self.wanted: str | None = None  # by the operator
        self.switches: deque[SourceSwitch] = deque(maxlen=KEPT_SWITCHES)

    def note_received(
        self, source: str, now_ns: int, rank: int = 0, *, valid: bool = True, sd: float | None = None
    ) -> bool:
        """Record a message of a device; True if the device is new or was silent.

        Parameters
        ----------
        source : str
            Its name.
        now_ns : int
            When the message was received.
        rank : int
            Lower ranks are preferred.
        valid : bool
            Whether the message can be used.
        sd : float, optional
            [m] Standard deviation that it states.
        """
        known = self._sources.get(source)
        if known is None:
            if len(self._sources) >= MAX_SOURCES:
                return False
            known = self._sources[source] = Source(now_ns, rank)
            is_new = True
        else:
            is_new = now_ns - known.received_ns > self._silent_ns
        known.received_ns, known.rank = now_ns, rank
        if valid:
            known.valid_ns, known.sd = now_ns, sd
        return is_new

    def names(self, now_ns: int) -> list[str]:
        """Devices that are not silent."""
        return [name for name, source in self._sources.items() if now_ns - source.received_ns <= self._silent_ns]

    def choose(self, now_ns: int) -> str | None:
        """Select a device; None if none is active."""
        active = self.names(now_ns)
        valid = [name for name in active if self._is_valid(name, now_ns)]
        chosen, reason = self._chosen(active, valid, now_ns)
        if chosen is not None and self.chosen is not None and chosen != self.chosen:
            self.switches.append(
                SourceSwitch(kind=self._kind, before=self.chosen, after=chosen, sampled_ns=now_ns, reason=reason)
            )
        self.chosen = chosen if chosen is not None or not active else self.chosen
        return self.chosen

    def _chosen(self, active: list[str], valid: list[str], now_ns: int) -> tuple[str | None, str]:
        """Device to be selected, and why it takes the place of the selected one."""
        selected, pool = self.chosen, valid or active
        best = min(pool, key=self._preference, default=None)
        if self.wanted in valid:
            return self.wanted, "the operator wants it"
        if selected is None or selected not in pool:
            lost = (
                f"no valid message of {selected} for {VALID_S:g} s" if selected in active else f"{selected} is silent"
            )
            return best, lost
        if self._by_name:
            return best, "first by its name"
        return self._better_than(selected, pool, now_ns) or (selected, "")

    def _better_than(self, selected: str, pool: list[str], now_ns: int) -> tuple[str, str] | None:
        """Device that takes the place of one whose messages are valid."""
        for name in pool:
            if receiver_of(name) == receiver_of(selected) and self._sources[name].rank < self._sources[selected].rank:
                return name, "preferred messages of the same receiver"
        better = [name for name in pool if self._is_better(name, selected, now_ns)]
        return (better[0], f"less than half the standard deviation for {BETTER_FOR_S:g} s") if better else None

    def _preference(self, name: str) -> tuple[int, str]:
        """Key by which a device is selected first: devices of equal rank in the order in which they were received."""
        return (0, name) if self._by_name else (self._sources[name].rank, "")

    def _is_valid(self, name: str, now_ns: int) -> bool:
        valid_ns = self._sources[name].valid_ns
        return valid_ns is not None and now_ns - valid_ns <= VALID_S * NS

    def _is_better(self, name: str, selected: str, now_ns: int) -> bool:
        """Whether a device has stated much less than the selected one for long enough."""
        one, own = self._sources[name], self._sources[selected].sd
        if name == selected or one.sd is None or own is None or one.sd >= BETTER_SD_RATIO * own:
            one.better_since_ns = None
            return False
        one.better_since_ns = now_ns if one.better_since_ns is None else one.better_since_ns
        return now_ns - one.better_since_ns >= BETTER_FOR_S * NS

    def age_s(self, now_ns: int) -> float | None:
        """Time since the last message of any device of this kind."""
        return age_s(max((source.received_ns for source in self._sources.values()), default=None), now_ns)


def age_s(at_ns: int | None, now_ns: int) -> float | None:
    """Time since an instant; None if there was none."""
    return None if at_ns is None else max(now_ns - at_ns, 0) / NS

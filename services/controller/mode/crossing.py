"""Crossing by ferry or train: begun and ended by the driver, and closed when the wheels turn."""

from collections.abc import Iterator

from shared.messages.operation import Crossing, CrossingEnd
from shared.messages.vehicle import VehicleSpeed

NS = 1_000_000_000
CLOSED_AFTER_M = 100.0  # [m] distance of the wheels that no movement on a deck needs
LONGEST_STEP_S = 2.0  # [s] between two speeds over which distance is integrated


class CrossingLog:
    """The crossing that is open, and the distance that the wheels have turned in it."""

    def __init__(self) -> None:
        self.since_ns: int | None = None  # None: no crossing is open
        self.wheels_m = 0.0
        self._last: tuple[int, float] | None = None  # stamp and speed
        self._known = False  # whether a state was published or taken over in this run

    def adopt(self, stored: Crossing, now_ns: int) -> Iterator[Crossing]:
        """Go on with a crossing that was open when the unit ended; its time before the start is not counted."""
        if not self._known and stored.is_open:
            yield self.begin(now_ns)

    def begin(self, now_ns: int) -> Crossing:
        """Open a crossing."""
        self.since_ns, self.wheels_m, self._last, self._known = now_ns, 0.0, None, True
        return Crossing(sampled_ns=now_ns, is_open=True, since_ns=now_ns)

    def end(self, now_ns: int, by: CrossingEnd) -> Crossing:
        """Close the crossing that is open.

        Raises
        ------
        ValueError
            No crossing is open.
        """
        if self.since_ns is None:
            raise ValueError("no crossing is open")
        begun_ns, self.since_ns = self.since_ns, None
        return Crossing(
            sampled_ns=max(now_ns, begun_ns), is_open=False, since_ns=begun_ns, ended_by=by,
            wheels_m=min(self.wheels_m, 1e6),
        )  # fmt: skip

    def use_speed(self, message: VehicleSpeed, now_ns: int) -> Iterator[Crossing]:
        """Integrate the speed of the wheels; a vehicle that drives is not carried."""
        if self.since_ns is None or message.speed_m_s is None:
            return
        speed, last = abs(message.speed_m_s), self._last
        if last is not None and message.sampled_ns <= last[0]:
            return
        self._last = (message.sampled_ns, speed)
        if last is None:
            return
        step_s = min((message.sampled_ns - last[0]) / NS, LONGEST_STEP_S)
        self.wheels_m += 0.5 * (speed + last[1]) * step_s
        if self.wheels_m >= CLOSED_AFTER_M:
            yield self.end(now_ns, CrossingEnd.WHEELS)

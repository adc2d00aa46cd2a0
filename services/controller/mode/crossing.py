"""Crossing by ferry or train: begun and ended by the driver, and closed when the wheels turn."""

from collections.abc import Iterator

from shared.messages.operation import Crossing, CrossingEnd
from shared.messages.vehicle import VehicleSpeed

NS = 1_000_000_000
CLOSED_AFTER_M = 100.0  # [m] distance of the wheels that no movement on a deck needs
KEPT_EACH_S, KEPT_EACH_M = 60.0, 10.0  # [s, m] between two messages of a crossing that is open
LONGEST_NS = 366 * 86_400 * NS  # of a stored crossing: a span that no stamp of a bad message may exceed
LONGEST_STEP_S = 2.0  # [s] between two speeds over which distance is integrated


class CrossingLog:
    """The crossing that is open, and the distance that the wheels have turned in it."""

    def __init__(self) -> None:
        self.since_ns: int | None = None  # None: no crossing is open
        self.wheels_m = 0.0
        self._last: tuple[int, float] | None = None  # stamp and speed
        self._published_ns, self._published_m = 0, 0.0
        self._known = False  # whether a state was published or taken over in this run

    def adopt(self, stored: Crossing, now_ns: int) -> Iterator[Crossing]:
        """Go on with a crossing that was open when the unit ended.

        Its time and the distance of its wheels are kept, so that no restart opens it longer; stamps of another start
        mean nothing, so that the time is carried over as a span. While the unit was off, nothing is counted.
        """
        if self._known or not stored.is_open:
            return
        open_ns = min(max(0, stored.sampled_ns - stored.since_ns), LONGEST_NS)
        self.begin(now_ns)
        self.since_ns, self.wheels_m = now_ns - open_ns, stored.wheels_m
        yield self._state(now_ns)

    def keep(self, now_ns: int) -> Iterator[Crossing]:
        """Publish the crossing that is open each minute and each 10 m: a restart goes on with what the broker keeps."""
        due = now_ns - self._published_ns >= KEPT_EACH_S * NS or self.wheels_m - self._published_m >= KEPT_EACH_M
        if self.since_ns is not None and due:
            yield self._state(now_ns)

    def _state(self, now_ns: int) -> Crossing:
        assert self.since_ns is not None
        self._published_ns, self._published_m = now_ns, self.wheels_m
        return Crossing(
            sampled_ns=max(now_ns, self.since_ns), is_open=True, since_ns=self.since_ns,
            wheels_m=min(self.wheels_m, 1e6),
        )  # fmt: skip

    def begin(self, now_ns: int) -> Crossing:
        """Open a crossing."""
        self.since_ns, self.wheels_m, self._last, self._known = now_ns, 0.0, None, True
        return self._state(now_ns)

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

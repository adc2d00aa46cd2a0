"""Recognises a receiver that repeats its last speed after the loss of its signals."""

from .aligned import SECOND_NS

MIN_EQUAL_EPOCHS = 3  # equal speeds in a row
HOLD_TIME_S = 2.0
USUAL_HOLD_S = 15.0  # receivers repeat a speed for about 10 s after a loss; longer is a fault


class HeldSpeed:
    """A run of equal, non-zero GNSS speeds during which the odometer's speed has changed by more than one step."""

    def __init__(self) -> None:
        self._speed: float | None = None
        self._since_ns = 0
        self._epochs = 0
        self._slowest: float | None = None
        self._fastest: float | None = None
        self._resolution = 0.0
        self.newest_ns = 0

    def gnss(self, time_ns: int, speed: float | None) -> None:
        """Use the receiver's speed [m/s] as it is reported."""
        if speed is None or speed == 0.0 or speed != self._speed:
            self._speed, self._since_ns, self._epochs = speed, time_ns, 0
            self._slowest = self._fastest = None
        self._epochs += 1
        self.newest_ns = time_ns

    def odometer(self, speed: float, resolution: float) -> None:
        """Use the odometer's speed and resolution [m/s]."""
        self._slowest = speed if self._slowest is None else min(self._slowest, speed)
        self._fastest = speed if self._fastest is None else max(self._fastest, speed)
        self._resolution = resolution

    @property
    def since_ns(self) -> int | None:
        """First stamp of the speed that is being repeated; None if the receiver measures."""
        if not self._speed or self._epochs < MIN_EQUAL_EPOCHS or self._slowest is None or self._fastest is None:
            return None
        changed = self._fastest - self._slowest > max(1.5 * self._resolution, 0.1)
        return self._since_ns if changed and self.held_s >= HOLD_TIME_S else None

    @property
    def held_s(self) -> float:
        """Time [s] for which the receiver has reported the same speed."""
        return (self.newest_ns - self._since_ns) / SECOND_NS

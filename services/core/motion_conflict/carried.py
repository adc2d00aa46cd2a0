"""Recognises that a ferry or train may carry the vehicle: wheels stand, GNSS moves, and the gyroscope agrees.

A receiver that is spoofed along a straight road looks the same: the finding is a question, and never an excuse.
"""

from collections import deque
from dataclasses import dataclass
from math import atan2, hypot, pi

from .aligned import SECOND_NS

WINDOW_S = 60.0  # [s] over which turns are compared
MOVING_M_S = 1.5  # [m/s] speed of GNSS that no parked vehicle has
MOVED_S = 30.0  # [s] of movement before there is a question
STALE_S = 5.0  # [s] age of a speed of the wheels, or of GNSS, at which nothing is found
TURN_LIMIT = 10.0 * pi / 180.0  # [rad] a gyroscope bias of 0.1 deg/s over the window, and the course of a slow ferry
LONGEST_GAP_S = 0.5  # [s] between inertial samples over which the yaw rate is integrated


@dataclass(frozen=True)
class CarriedFinding:
    """Movement without wheels."""

    moved_s: float
    speed: float  # [m/s] newest
    turn_difference: float  # [rad] turn of the course minus that of the gyroscope over the window, absolute

    @property
    def turns_agree(self) -> bool:
        """Whether the gyroscope turned as GNSS did."""
        return self.turn_difference <= TURN_LIMIT


class Carried:
    """Speeds of the wheels, velocities of GNSS, and the yaw that the gyroscope has counted, as they come."""

    def __init__(self) -> None:
        self._wheels_ns: int | None = None  # newest speed of the wheels
        self._yaw = 0.0  # [rad] counted, clockwise
        self._imu_ns: int | None = None
        self._moves: deque[tuple[int, float, float, float]] = deque(maxlen=1024)  # stamp, speed, course, yaw

    def wheels(self, time_ns: int, speed: float) -> None:
        """Use a speed [m/s] of the wheels; one that is not zero ends the movement without wheels."""
        self._wheels_ns = time_ns
        if speed > 0.0:
            self._moves.clear()

    def gyroscope(self, time_ns: int, yaw_rate: float) -> None:
        """Use a yaw rate [rad/s, about the vehicle's down axis]."""
        step_s = 0.0 if self._imu_ns is None else (time_ns - self._imu_ns) / SECOND_NS
        self._imu_ns = time_ns
        if 0.0 < step_s <= LONGEST_GAP_S:
            self._yaw += yaw_rate * step_s

    def gnss(self, time_ns: int, velocity_ned: tuple[float, float, float] | None) -> None:
        """Use a velocity [m/s, NED] of GNSS; None or one at rest ends the movement."""
        speed = 0.0 if velocity_ned is None else hypot(*velocity_ned[:2])
        if velocity_ned is None or speed < MOVING_M_S:
            self._moves.clear()
            return
        self._moves.append((time_ns, speed, atan2(velocity_ned[1], velocity_ned[0]), self._yaw))
        while time_ns - self._moves[0][0] > (MOVED_S + WINDOW_S) * SECOND_NS:
            self._moves.popleft()

    def finding(self, time_ns: int) -> CarriedFinding | None:
        """Find movement without wheels whose turns agree; None without wheels, without movement, or where they do not.

        Without a gyroscope turns are not compared, and nothing is found.
        """
        found = self.movement(time_ns)
        return found if found is not None and found.turns_agree else None

    def movement(self, time_ns: int) -> CarriedFinding | None:
        """Find movement without wheels, whether the turns agree or not."""
        fresh_ns = time_ns - round(STALE_S * SECOND_NS)
        if not self._moves or self._moves[-1][0] < fresh_ns or self._wheels_ns is None or self._wheels_ns < fresh_ns:
            return None
        newest_ns, speed, course, yaw = self._moves[-1]
        moved_s = (newest_ns - self._moves[0][0]) / SECOND_NS
        if moved_s < MOVED_S or self._imu_ns is None or self._imu_ns < fresh_ns:
            return None
        first = next(move for move in self._moves if newest_ns - move[0] <= WINDOW_S * SECOND_NS)
        difference = (course - first[2]) - (yaw - first[3])
        turn = abs((difference + pi) % (2.0 * pi) - pi)
        return CarriedFinding(moved_s, speed, turn)

"""Three velocities of one receiver: by carrier phases, by Doppler, and as it states them.

All three are of the same antenna and the same satellites. Where one of them departs from the other two, the receiver
or its filter is wrong. A spoofer whose signals are consistent passes all three: this is no independent check of GNSS.
"""

from collections import deque
from dataclasses import dataclass
from enum import StrEnum
from itertools import combinations

import numpy as np
import numpy.typing as npt

from shared.messages.gnss import CarrierDisplacement, GnssFix

FloatArray = npt.NDArray[np.float64]

NS = 1_000_000_000
WINDOW_S = 5.0  # of the means, in which errors of an interval by changing accelerations cancel
LEAST_S = 3.0  # covered by intervals of the window
SAME_EPOCH_NS = 2_000_000
WAITING = 20  # displacements and fixes at most that wait for each other
LAG_S = 0.3  # by which a receiver's filter may be late, times the mean acceleration
SDS = 3.0
UNKNOWN_SD_M_S = 0.2  # of a receiver that states none


class Velocity(StrEnum):
    """Which of the velocities."""

    CARRIER = "carrier"
    DOPPLER = "doppler"
    RECEIVER = "receiver"
    ALL = "all"  # each differs from each


@dataclass(frozen=True)
class Difference:
    """Mean distance of one velocity from the other two."""

    time_ns: int
    differs: Velocity
    distance_m_s: float  # from the nearer of the two
    limit_m_s: float


@dataclass(frozen=True)
class _Interval:
    """Velocities [m/s, NED] of an interval: by carrier, by Doppler, of the receiver; and their deviations, 3-D."""

    time_ns: int
    span_s: float
    velocities: FloatArray  # shape (3, 3)
    sds: FloatArray  # shape (3,)


class VelocityComparison:
    """Compares the velocities of one receiver, once its fixes at both ends of a displacement are there."""

    def __init__(self, limit_m_s: float) -> None:
        self._limit_m_s = limit_m_s
        self._fixes: deque[tuple[int, FloatArray, float]] = deque(maxlen=WAITING)
        self._waiting: deque[CarrierDisplacement] = deque(maxlen=WAITING)
        self._intervals: deque[_Interval] = deque(maxlen=round(WINDOW_S * 100))

    def fix(self, message: GnssFix) -> Difference | None:
        """Use the velocity that the receiver states."""
        if message.velocity_ned_m_s is None:
            return None
        sd = message.velocity_sd_ned_m_s
        sd_m_s = UNKNOWN_SD_M_S if sd is None else float(np.linalg.norm(sd))
        self._fixes.append((message.sampled_ns, np.array(message.velocity_ned_m_s), sd_m_s))
        return self._compare()

    def displacement(self, message: CarrierDisplacement) -> Difference | None:
        """Use a displacement; one that is not checked, or has no Doppler, is left out."""
        if message.checked and message.doppler_velocity_ned_m_s is not None and message.since_ns < message.sampled_ns:
            self._waiting.append(message)
        return self._compare()

    def _compare(self) -> Difference | None:
        """Difference after the newest interval, if there is another one."""
        found = None
        for message in list(self._waiting):
            first, second = (self._at(time_ns) for time_ns in (message.since_ns, message.sampled_ns))
            if first is not None and second is not None:
                self._waiting.remove(message)
                self._add(_interval(message, first, second))
                found = self._judged(message.sampled_ns)
        return found

    def _at(self, time_ns: int) -> tuple[FloatArray, float] | None:
        near = [(velocity, sd) for stamp, velocity, sd in self._fixes if abs(stamp - time_ns) < SAME_EPOCH_NS]
        return near[-1] if near else None

    def _add(self, interval: _Interval) -> None:
        if self._intervals and not 0 < interval.time_ns - self._intervals[-1].time_ns < WINDOW_S * NS:
            self._intervals.clear()
        self._intervals.append(interval)
        while self._intervals[0].time_ns <= interval.time_ns - WINDOW_S * NS:
            self._intervals.popleft()

    def _judged(self, time_ns: int) -> Difference | None:
        """Which velocity departs from the others, and by how much of its limit.

        Notes
        -----
        Of the three distances of means, each over its limit, the two largest have one velocity in common. It differs
        as far as the smaller of these two, because two that agree cannot both be wrong in the same way by chance.
        """
        spans = np.array([interval.span_s for interval in self._intervals])
        if spans.sum() < LEAST_S:
            return None
        weights = spans / spans.sum()
        means = np.einsum("k,kij->ij", weights, np.array([interval.velocities for interval in self._intervals]))
        sds = weights @ np.array([interval.sds for interval in self._intervals])
        first, last = self._intervals[0].velocities[0], self._intervals[-1].velocities[0]
        late_m_s = LAG_S * float(np.linalg.norm(last - first)) / float(spans.sum())
        rated = []
        for i, j in combinations(range(3), 2):
            limit = self._limit_m_s + SDS * float(np.hypot(sds[i], sds[j])) + late_m_s
            rated.append((float(np.linalg.norm(means[i] - means[j])) / limit, {i, j}, limit))
        rated.sort(key=lambda pair: pair[0])
        (smallest, _, _), (ratio, pair, limit), (_, other, _) = rated
        common = (*Velocity,)[(pair & other).pop()]
        return Difference(time_ns, Velocity.ALL if smallest > 1.0 else common, ratio * limit, limit)


def _interval(
    message: CarrierDisplacement, first: tuple[FloatArray, float], second: tuple[FloatArray, float]
) -> _Interval:
    span_s = (message.sampled_ns - message.since_ns) / NS
    nn, _, _, ee, _, dd = message.displacement_cov_ned_m2
    assert message.doppler_velocity_ned_m_s is not None
    velocities = np.array(
        [np.array(message.displacement_ned_m) / span_s, message.doppler_velocity_ned_m_s, 0.5 * (first[0] + second[0])]
    )
    carrier_sd = float(np.sqrt(max(nn + ee + dd, 0.0))) / span_s
    doppler_sd = float(np.linalg.norm(message.doppler_sd_ned_m_s or (UNKNOWN_SD_M_S,) * 3))
    return _Interval(
        message.sampled_ns, span_s, velocities, np.array([carrier_sd, doppler_sd, max(first[1], second[1])])
    )

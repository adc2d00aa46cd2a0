"""Compares the velocity of GNSS with inertial sensors over 5, 30 and 60 s."""

from collections import Counter
from collections.abc import Iterator
from math import radians

import numpy as np
import numpy.typing as npt

from shared.maths.rotation import ned_from_body
from shared.messages.base import Symmetric3, Tick
from shared.messages.gnss import FixType, GnssFix
from shared.messages.imu import ImuSamples
from shared.messages.navigation import NavigationPhase, NavigationSolution
from shared.messages.trust import TrustMonitor
from shared.messages.vehicle import VehicleSpeed

from .monitor import InertialMonitor
from .settings import Settings
from .statements import statements
from .strapdown import Anchor

In = ImuSamples | GnssFix | VehicleSpeed | NavigationSolution | Tick
WITH_HEADING = (NavigationPhase.NAVIGATING, NavigationPhase.COASTING)
MEASURED = (FixType.TWO_D, FixType.THREE_D, FixType.GNSS_DEAD_RECKONING)
RESTART_NS = 5_000_000_000  # by which a stamp is earlier than the newest one where a time line starts again
SILENT_NS = 5_000_000_000  # after which another source takes the place of one that is silent


class Config(Settings):
    """Settings of core.spoofing."""


class Process:
    """Publishes the statements `inertial_short` and `inertial_long` once a second."""

    def __init__(self, config: Config) -> None:
        self._config = config
        self.monitor = InertialMonitor(config)
        self._newest_ns = 0
        self._sources: dict[type, tuple[str, int]] = {}  # one of each kind, with the last time of arrival

    @property
    def rejects(self) -> Counter[str]:
        """Rejected input by reason."""
        return self.monitor.rejected

    def handle(self, message: In) -> Iterator[TrustMonitor]:
        """Use a measurement or a solution; publish with each tick."""
        match message:
            case ImuSamples() if self._is_chosen(message):
                self._use_samples(message)
            case GnssFix() if self._is_chosen(message):
                velocity = message.velocity_ned_m_s if message.fix_type in MEASURED else None
                self.monitor.fix(message.sampled_ns, velocity, message.velocity_sd_ned_m_s)
            case VehicleSpeed() if self._is_chosen(message):
                self.monitor.odometer(message.sampled_ns, message.speed_m_s, message.resolution_m_s)
            case NavigationSolution() if message.phase in WITH_HEADING:
                self.monitor.solution(anchor_of(message))
            case Tick():
                time_ns = max(self._newest_ns, message.now_ns)
                yield from statements(self.monitor.verdicts(time_ns), time_ns)

    def _is_chosen(self, message: ImuSamples | GnssFix | VehicleSpeed) -> bool:
        """Whether a message comes from the one source of its kind that is used."""
        kind, now_ns = type(message), message.received_ns
        chosen, last_ns = self._sources.get(kind, (message.source, now_ns))
        if message.source != chosen and 0 <= now_ns - last_ns <= SILENT_NS:
            self.rejects[f"{kind.__name__} of a second source"] += 1
            return False
        self._sources[kind] = (message.source, now_ns)
        return True

    def _use_samples(self, batch: ImuSamples) -> None:
        if batch.saturated:
            self.rejects["imu: saturated"] += 1
            return
        if self._newest_ns - batch.sampled_ns[-1] > RESTART_NS:
            self._restart(batch.sampled_ns[-1])
        samples = zip(batch.sampled_ns, batch.specific_force_body_m_s2, batch.angular_rate_body_rad_s, strict=True)
        for time_ns, force, rate in samples:
            self.monitor.inertial(time_ns, force, rate)
        self._newest_ns = max(self._newest_ns, batch.sampled_ns[-1])
        if batch.pressure_pa is not None:
            self.monitor.pressure(batch.sampled_ns[-1], batch.pressure_pa)

    def _restart(self, time_ns: int) -> None:
        """Start again with what was counted, because the time line has started again earlier."""
        rejected = self.rejects
        self.monitor = InertialMonitor(self._config)
        self.rejects.update(rejected)
        self.rejects["time line started again"] += 1
        self._newest_ns = time_ns


def anchor_of(solution: NavigationSolution) -> Anchor:
    """Read a solution as the start of a propagation."""
    return Anchor(
        time_ns=solution.sampled_ns,
        ned_from_body=ned_from_body(solution.roll_rad, solution.pitch_rad, solution.yaw_rad),
        velocity_n=np.array(solution.velocity_ned_m_s),
        accelerometer_bias=np.array(solution.accelerometer_bias_m_s2),
        gyroscope_bias=np.array(solution.gyroscope_bias_rad_s),
        velocity_cov=_matrix(solution.velocity_cov_ned_m2_s2),
        attitude_cov=_matrix(solution.attitude_cov_ned_rad2),
        latitude=radians(solution.latitude_deg),
        height=solution.height_ellipsoid_m,
        stationary=solution.stationary,
        gnss_age_s=solution.gnss_age_s,
        gyroscope_bias_sd=np.array(solution.gyroscope_bias_sd_rad_s or (0.0, 0.0, 0.0)),
    )


def _matrix(cov: Symmetric3) -> npt.NDArray[np.float64]:
    nn, ne, nd, ee, ed, dd = cov
    return np.array([[nn, ne, nd], [ne, ee, ed], [nd, ed, dd]])

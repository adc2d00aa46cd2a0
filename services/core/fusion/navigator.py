"""The navigator: inertial samples and fixes in, solutions out, with no bus and no messages.

navigator = Navigator(Settings(gnss=GnssSettings(lever_arm_body_m=(0.3, 0.0, -1.2))))
navigator.fix(t_ns, position=Geodetic(...), velocity=(...))
navigator.imu(t_ns, force, rate)
solution = navigator.solution()
"""

from bisect import insort
from collections import Counter
from collections.abc import Sequence
from math import isfinite

import numpy as np
import numpy.typing as npt

from shared.maths.earth import Geodetic
from shared.maths.rotation import Vector
from shared.messages.navigation import NavigationPhase

from .alignment.heading import Prior
from .alignment.warm_start import SavedState, fault, saved_state
from .measurements import barometer, magnetometer
from .measurements.base import Counts, Measurement, Outcome
from .measurements.gnss import GnssPosition, GnssVelocity, Reading, Stamp, gnss_measurements
from .measurements.odometer import WheelSpeed
from .plausibility.imu_faults import Repeats, Sample, credible, unremarkable
from .plausibility.measurements import Devices, impossible
from .settings import Settings
from .smoothing.history import HistoryRecorder
from .solution import Bounds, Solution, solution_of
from .timing.delay_compensation import SuspectedDelay
from .timing.imu_clock import FUTURE_LIMIT_NS, Clock
from .timing.out_of_sequence import OutOfSequenceEngine, key_of
from .timing.roll_back import RollBack
from .update.engine import Engine
from .update.imu_gaps import LostTime

FloatArray = npt.NDArray[np.float64]

NEWEST_LIMIT = 256  # kinds of measurements of devices
HELD_LIMIT = 1000  # measurements that wait for an inertial sample
SPEED_PERIOD_NS = 95_000_000  # wheel speeds are used at most this often
FAULT_FREE_NS = 3_000_000_000  # after a fault-free fix, in which another one is expected
FAULT_FREE_WAIT_NS = 1_000_000_000
NEW_DELAY_S = 0.1  # change of a suspected delay that matters


class Navigator:
    """Loosely coupled INS/GNSS whose result depends on stamps alone, and not on the order of arrival.

    A fix waits until an inertial sample comes that was received `merge_delay_s` later, whatever the bus made of their
    order; then it is used at the instant at which it was true.
    """

    def __init__(self, settings: Settings | None = None) -> None:
        self.settings = settings or Settings()
        self.rejects: Counter[str] = Counter()
        self.samples_used = 0
        self.samples_rejected = 0
        self.measurements_late = 0  # used at their own time, after newer ones of the same device
        self._roll_back = RollBack(self.settings)
        self._bounds = Bounds(self.settings)
        self._clock: Clock | None = None  # while samples are refused for their stamps
        self._repeats: Repeats | None = None
        self._remarkable = True  # the last sample was checked, and is known to `_repeats`
        self._newest: dict[tuple[str, type], int] = {}  # stamp of what was used of a device, by kind
        self._suspected = 0.0, 0.0  # [s] delays of GNSS
        self._devices = Devices(self.rejects, self._now_ns)
        self._fault_free_ns = -FAULT_FREE_NS  # stamp of the newest fix without an excluded satellite
        self._held: list[tuple[int, int, str, Measurement]] = []  # (released by, stamp, source, measurement)

    def imu(
        self,
        time_ns: int,
        force: Sequence[float],
        rate: Sequence[float],
        received_ns: int | None = None,
        *,
        saturated: bool = False,
    ) -> list[Outcome]:
        """Take one inertial sample, and use what has waited for it: `advance` and `release` in one.

        Parameters
        ----------
        time_ns : int
            End of the time over which the sample is the mean.
        force : sequence of three floats
            [m/s², body] Specific force as measured.
        rate : sequence of three floats
            [rad/s, body] Angular rate as measured.
        received_ns : int, optional
            When it arrived at the driver; `time_ns` if not given.
        saturated : bool
            Whether the sensor says that it was driven beyond its range.

        Returns
        -------
        list of Outcome
            What became of the measurements that were used since this was asked last.
        """
        self.advance(time_ns, force, rate, received_ns, saturated=saturated)
        return self.release(time_ns if received_ns is None else received_ns)

    def advance(
        self,
        time_ns: int,
        force: Sequence[float],
        rate: Sequence[float],
        received_ns: int | None = None,
        *,
        saturated: bool = False,
    ) -> None:
        """Take one inertial sample; `release` must follow, and may come after a look at the solution."""
        fx, fy, fz = force
        wx, wy, wz = rate
        sample, last = Sample(time_ns, (fx, fy, fz), (wx, wy, wz)), self._oosm.newest
        follows = last is not None and 0 < time_ns - last.time_ns <= FUTURE_LIMIT_NS and not (saturated or self._clock)
        if follows and last is not None and unremarkable(sample, last):
            self._remarkable = False
        else:
            if reason := self._unusable(sample, received_ns):
                self.samples_rejected += 1
                self.rejects[reason] += 1
                return
            if self._clock:
                self._settle_clock(time_ns, self._clock.lost_s)
            if fault := self._fault(sample, saturated=saturated):
                self.rejects[fault] += 1
                sample = sample._replace(fault=fault)
        self.samples_used += 1
        self._roll_back.add(sample)

    def measure(self, measurement: Measurement) -> None:
        """Take a measurement of any kind; it is used once the bus cannot bring an earlier one any more."""
        if measurement.time_ns > measurement.received_ns + FUTURE_LIMIT_NS:
            self.rejects["measurement from the future"] += 1
            return
        if fault := impossible(measurement):
            self.rejects[fault] += 1
            return
        if not self._devices.is_known(measurement.source):
            return
        release_ns = measurement.received_ns + int(self.settings.merge_delay_s * 1e9)
        if isinstance(measurement, GnssPosition | GnssVelocity):
            release_ns += self._await_fault_free(measurement)
        entry = (release_ns, measurement.time_ns, measurement.source, measurement)
        insort(self._held, entry, key=lambda held: held[:3])
        if len(self._held) > HELD_LIMIT:
            self._held.pop(0)
            self.rejects["held without inertial samples"] += 1

    def fix(
        self,
        time_ns: int,
        *,
        position: Geodetic,
        velocity: Vector | None = None,
        position_sd: Vector | None = None,
        velocity_sd: Vector | None = None,
        received_ns: int | None = None,
        source: str = "gnss",
    ) -> None:
        """Take position [rad, rad, m] and velocity [m/s, NED] of the antenna, with standard deviations, at a stamp."""
        stamp = Stamp(time_ns, time_ns if received_ns is None else received_ns, source)
        reading = Reading((0.0, 0.0, 0.0), _diagonal(position_sd))
        moving = None if velocity is None else Reading(velocity, _diagonal(velocity_sd))
        for measurement in gnss_measurements(self.settings, stamp, position, reading, moving):
            self.measure(measurement)

    def speed(
        self,
        time_ns: int,
        speed: float,
        *,
        resolution: float = 0.0,
        of_wheels: bool = True,
        exact: bool = True,
        received_ns: int | None = None,
        source: str = "wheels",
    ) -> None:
        """Take a speed [m/s] of the vehicle at a stamp; ten a second of each device are enough.

        It is `exact` if it is that of both rear wheels, and its resolution [m/s] is the step in which it comes.
        """
        if not self.settings.odometer.enabled or not self._devices.is_due(source, "speed", time_ns, SPEED_PERIOD_NS):
            return
        arrival_ns = time_ns if received_ns is None else received_ns
        self.measure(WheelSpeed(time_ns, arrival_ns, source, speed, resolution, of_wheels, exact, self.settings))

    def pressure(
        self, time_ns: int, pressure_pa: float, *, received_ns: int | None = None, source: str = "barometer"
    ) -> None:
        """Take a static pressure [Pa] at a stamp; one a second is used."""
        if not self.settings.barometer.enabled or not self._devices.is_due(
            source, "pressure", time_ns, barometer.PERIOD_NS
        ):
            return
        if not barometer.LOWEST_PA <= pressure_pa <= barometer.HIGHEST_PA:
            self.rejects["pressure of no road"] += 1
            return
        height = barometer.pressure_height(pressure_pa)
        arrival_ns = time_ns if received_ns is None else received_ns
        self.measure(barometer.BarometricHeight(time_ns, arrival_ns, source, height, self.settings))

    def magnetic_field(
        self, time_ns: int, field_b: Vector, *, received_ns: int | None = None, source: str = "compass"
    ) -> None:
        """Take a magnetic field [body, 1 where it was calibrated] at a stamp; one a second is used."""
        if not self.settings.magnetometer.enabled or not self._devices.is_due(
            source, "field", time_ns, magnetometer.PERIOD_NS
        ):
            return
        arrival_ns = time_ns if received_ns is None else received_ns
        declination = self.settings.magnetometer.declination_rad
        self.measure(magnetometer.MagneticHeading(time_ns, arrival_ns, source, field_b, declination))

    def record_history(self, recorder: HistoryRecorder) -> None:
        """Record a history for the smoother, from the first sample on."""
        self._oosm.record_history(recorder)

    def use_prior(self, prior: Prior) -> None:
        """Take the position and heading that were saved before the power went."""
        self._oosm.use_prior(prior)

    def restore(self, saved: SavedState, time_ns: int) -> None:
        """Go on from the state of an earlier process if it is sound and fresh at the stamp of the first sample."""
        if reason := fault(saved, time_ns):
            self.rejects[reason] += 1
        else:
            self._oosm.restore(saved)

    def saved_state(self) -> SavedState | None:
        """Take out what a later process can go on from; None while no filter runs."""
        engine = self._oosm.engine
        if engine.filter is None or engine.last is None:
            return None
        return saved_state(engine.filter, engine.last, engine.accepted_ns, engine.exclusions.gnss_since_ns)

    def follow_trust(self, gnss_suspect_since_ns: int | None, *, odometer_excluded: bool) -> None:
        """Exclude GNSS since a suspect time, None to use it, and the odometer, as core.trust has decided."""
        self._roll_back.follow(gnss_suspect_since_ns, odometer_excluded=odometer_excluded)

    def suspect_delay(self, position_s: float, velocity_s: float) -> None:
        """Allow for delays [s] of GNSS positions and velocities that no setting corrects, from now on; 0 ends it."""
        newest, (old_s, old_velocity_s) = self._oosm.newest, self._suspected
        changes = abs(position_s - old_s), abs(velocity_s - old_velocity_s)
        if newest is None or self.settings.estimate_delays or max(changes) < NEW_DELAY_S:
            return
        self._suspected = position_s, velocity_s
        grown_s = max(0.0, abs(velocity_s) - abs(old_velocity_s))
        self._roll_back.insert(SuspectedDelay(newest.time_ns + 1, position_s, velocity_s, grown_s))

    @property
    def _oosm(self) -> OutOfSequenceEngine:
        return self._roll_back.engine

    @property
    def engine(self) -> Engine:
        """The estimator as of the newest sample."""
        return self._oosm.engine

    @property
    def phase(self) -> NavigationPhase:
        """How far the filter has come."""
        return self._oosm.engine.phase

    @property
    def since_ns(self) -> int:
        """When the phase began."""
        return self._oosm.engine.since_ns

    @property
    def reason(self) -> str:
        """Why the phase began."""
        return self._oosm.engine.reason

    @property
    def counts(self) -> Counts:
        """What was used, rejected, bridged and reset."""
        return self._oosm.engine.counts

    @property
    def lever_arm_error(self) -> tuple[float, float] | None:
        """True minus assumed lever arm [m, forward and right], if GNSS contradicts the setting in turns."""
        return self._oosm.engine.aids.judge.arm.wrong()

    def solution(self) -> Solution | None:
        """State at the newest inertial sample, or None while there is no valid one."""
        return solution_of(self._oosm.engine, self._bounds)

    def release(self, received_ns: int) -> list[Outcome]:
        """Use what has waited long enough at `received_ns`, and report all outcomes since the last call."""
        last = self._oosm.newest
        while self._held and self._held[0][0] <= received_ns:
            measurement = self._held.pop(0)[3]
            if last is not None and measurement.time_ns > last.time_ns + FUTURE_LIMIT_NS:
                self.rejects["measurement from the future"] += 1  # by the clock of the inertial samples
                continue
            if self._roll_back.insert(measurement):
                self._count_if_late(measurement)
            else:
                self.rejects["measurement older than the memory"] += 1
        return self._roll_back.outcomes()

    def _await_fault_free(self, measurement: GnssPosition | GnssVelocity) -> int:
        """Time [ns] for which a fix waits for the fault-free one of its epoch, while there are any.

        A fault-free fix takes the place of one that waits.
        """
        if not measurement.left_out:
            after_ns = measurement.time_ns - self._fault_free_ns
            return FAULT_FREE_WAIT_NS if 0 < after_ns <= FAULT_FREE_NS else 0
        self._fault_free_ns = measurement.time_ns
        self._held = [held for held in self._held if key_of(held[3]) != key_of(measurement)]
        return 0

    def _now_ns(self) -> int:
        newest = self._oosm.newest
        return newest.time_ns if newest else 0

    def _count_if_late(self, measurement: Measurement) -> None:
        key = measurement.source, type(measurement)
        if len(self._newest) > NEWEST_LIMIT and key not in self._newest:
            self._newest.clear()  # devices come and go, and this counts only
        newest_ns = self._newest.setdefault(key, measurement.time_ns)
        self.measurements_late += measurement.time_ns < newest_ns
        self._newest[key] = max(newest_ns, measurement.time_ns)

    def _unusable(self, sample: Sample, received_ns: int | None) -> str | None:
        """Reason for which a sample cannot be used; None if it can."""
        time_ns, force, rate, _ = sample
        if not credible(force, rate):
            return "sample beyond any sensor" if isfinite(sum(force) + sum(rate)) else "sample not finite"
        last = self._oosm.newest
        if last is not None and not 0 < time_ns - last.time_ns <= FUTURE_LIMIT_NS:
            return self._misfit(sample, last.time_ns, received_ns)
        return None

    def _fault(self, sample: Sample, *, saturated: bool) -> str | None:
        """Fault of a sample that can be used; None without one."""
        time_ns, readings, last = sample.time_ns, (*sample.force, *sample.rate), self._oosm.newest
        repeats = self._repeats = self._repeats or Repeats(time_ns, readings)
        if last is not None and not self._remarkable:
            repeats.changed(last.time_ns, (*last.force, *last.rate))
            self._remarkable = True
        fault = repeats.fault(time_ns, readings)
        return "gyroscope saturated" if saturated else fault

    def _misfit(self, sample: Sample, newest_ns: int, received_ns: int | None) -> str | None:
        """Reason for which a sample does not follow the last one, or None; after many that go back begin again."""
        clock = self._clock or Clock()
        if sample.time_ns > newest_ns:
            if not clock.is_ahead(sample.time_ns, newest_ns, received_ns):
                return None
            self._clock = clock
            return "sample from the future"
        self._clock = clock
        if clock.goes_back(sample.time_ns, known=self._oosm.is_known(sample)):
            self._roll_back.restart("the inertial clock went back")
            self._clock, self._repeats, self._remarkable, self._newest = None, None, True, {}
            self._suspected = 0.0, 0.0
        return "sample doubled or out of order"

    def _settle_clock(self, time_ns: int, lost_s: float) -> None:
        """Go on after samples that were refused for their stamps, and admit the time that was lost with them."""
        self._clock = None
        if lost_s:
            self.rejects["time lost as the inertial clock went back"] += 1
            self._roll_back.insert(LostTime(time_ns, lost_s))


def _diagonal(sd: Vector | None) -> FloatArray | None:
    return None if sd is None else np.diag(np.square(sd))

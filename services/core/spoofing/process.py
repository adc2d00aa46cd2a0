"""Compares the velocity of GNSS with inertial sensors over 5, 30 and 60 s."""

import logging
from collections import Counter
from collections.abc import Iterator, Mapping
from math import cos, radians, sin
from pathlib import Path
from typing import cast

from pydantic import ValidationError, ValidationInfo, model_validator

from shared.bounded import SizeExceeded, read_bytes
from shared.chosen import ChosenSource, gnss_choice, imu_choice, speed_choice
from shared.errors import ConfigError
from shared.maths.earth import Geodetic
from shared.messages.base import Tick, Vector3
from shared.messages.explanation import Explanation, explain
from shared.messages.gnss import FixType, GnssFix
from shared.messages.imu import ImuSamples
from shared.messages.navigation import AidingUpdate, FilterState, NavigationPhase, NavigationSolution
from shared.messages.operation import ModeState, ProcessLoad, Work
from shared.messages.trust import LearnedGrade, TrustMonitor, TrustState
from shared.messages.vehicle import VehicleSpeed, WheelSpeeds
from shared.runtime.config import Table, VehicleFile, vehicle_in
from shared.trust.result import deciding, statement

from .codes import Code
from .drift.monitor import DriftMonitor
from .grade import DEFAULT_GRADE, LONG, OBSERVER, Grade, profile_of
from .gyroscope.monitor import GyroscopeMonitor, agreed
from .gyroscope.sources import fastest
from .inertial.anchors import is_readable
from .inertial.tracks import UNKNOWN_VERTICAL_SD
from .lesson import WindowCollection, profile_of_learned
from .monitor import InertialMonitor
from .observer.monitor import ObserverMonitor
from .profile import Origin, Profile
from .settings import LongSettings, ObserverSettings, Settings
from .statements import paused_statements, statements
from .windows.position_step import DEFAULT_SD_M

Measured = ImuSamples | GnssFix | VehicleSpeed | WheelSpeeds
In = (
    Measured
    | NavigationSolution
    | AidingUpdate
    | FilterState
    | LearnedGrade
    | TrustState
    | ModeState
    | ProcessLoad
    | Tick
)
Out = TrustMonitor | LearnedGrade
PROFILE_BYTES = 5_000_000
WITH_HEADING = (NavigationPhase.NAVIGATING, NavigationPhase.COASTING)
MEASURED = (FixType.TWO_D, FixType.THREE_D, FixType.GNSS_DEAD_RECKONING)
RESTART_NS = 5_000_000_000  # by which a stamp is earlier than the newest one where a time line starts again
SILENCE_TIMEOUT_NS = 5_000_000_000  # after which another source takes the place of one that is silent
RATED_S = 10.0  # of a source, after which its rate is known

log = logging.getLogger(__name__)


class Config(Settings):
    """Settings of core.spoofing.

    `profile` may be the name of a file that `obu calibrate spoofing` wrote, relative to the vehicle's file. The delay
    of GNSS and the random walks of the IMU are those of core.fusion where this section has none.
    """

    @model_validator(mode="before")
    @classmethod
    def _complete(cls, given: object, info: ValidationInfo) -> object:
        """Fill up from the section of core.fusion, then with the thresholds of the stated grade."""
        if not isinstance(given, dict):
            return given
        values = dict(given)
        if vehicle := vehicle_in(info.context):
            sections = {"gnss": _gnss_of_fusion(vehicle), "long": _long_of_fusion(vehicle)}
            values |= {key: {**section, **given.get(key, {})} for key, section in sections.items()}
            if isinstance(name := values.get("profile"), str):
                values["profile"] = read_profile(Path(vehicle.path).parent / name)
        grade = values.get("grade")
        return with_grade(values, Grade(grade)) if grade in list(Grade) else values


def with_grade(values: Mapping[str, object], grade: Grade) -> dict[str, object]:
    """Complete the values of this section by those of a grade; what is given stands, but for a smaller random walk."""
    long = values.get("long", {})
    given = long.model_dump(exclude_unset=True) if isinstance(long, LongSettings) else dict(cast(Table, long))
    for key, value in LONG[grade].items():
        walk = given.get(key) if "random_walk" in key else None
        given[key] = max(value, walk) if isinstance(walk, int | float) else given.get(key, value)
    observer = values.get("observer", {})
    stated = observer.model_dump(exclude_unset=True) if isinstance(observer, ObserverSettings) else observer
    return {
        "profile": profile_of(grade), **values, "long": given, "observer": {**OBSERVER[grade], **cast(Table, stated)},
    }  # fmt: skip


def _gnss_of_fusion(vehicle: VehicleFile) -> Table:
    """Delays of position and velocity, from the section of core.fusion."""
    gnss = vehicle.tables.get("core.fusion", {}).get("gnss", {})
    if not isinstance(gnss, dict):
        return {}
    delays = [gnss[key] for key in ("delay_s", "velocity_delay_s") if isinstance(gnss.get(key), int | float)]
    found: Table = {"position_delay_s": gnss["delay_s"]} if isinstance(gnss.get("delay_s"), int | float) else {}
    return found | ({"velocity_delay_s": sum(delays)} if delays else {})


def _long_of_fusion(vehicle: VehicleFile) -> Table:
    """Whether the odometer is used, and random walks of the IMU that are above the defaults of this section."""
    fusion = vehicle.tables.get("core.fusion", {})
    imu, odometer = fusion.get("imu", {}), fusion.get("odometer", {})
    used: Table = {"odometer": False} if isinstance(odometer, dict) and odometer.get("enabled") is False else {}
    if not isinstance(imu, dict):
        return used
    defaults = LongSettings()
    walks = {
        "angle_random_walk_rad_sqrt_s": defaults.angle_random_walk_rad_sqrt_s,
        "velocity_random_walk_m_s_sqrt_s": defaults.velocity_random_walk_m_s_sqrt_s,
    }
    given = {key: imu[key] for key in walks if isinstance(imu.get(key), int | float)}
    return used | {key: max(value, walks[key]) for key, value in given.items()}


def read_profile(path: Path) -> Profile:
    """Read a profile that `obu calibrate spoofing` wrote."""
    try:
        return Profile.model_validate_json(read_bytes(path, PROFILE_BYTES))
    except SizeExceeded as error:
        raise ConfigError(f"{path} is no profile: {error}; make it with `obu calibrate spoofing DRIVE`") from error
    except OSError as error:
        raise ConfigError(
            f"cannot read the profile {path}: {error.strerror}; make it with `obu calibrate spoofing`, or remove "
            "`profile` from [core.spoofing]"
        ) from error
    except ValidationError as error:
        reason = error.errors()[0]["msg"]
        raise ConfigError(f"{path} is no profile ({reason}); make it with `obu calibrate spoofing DRIVE`") from error


class Rate:
    """Source of one kind of message, and its rate."""

    def __init__(self) -> None:
        self.source = ""
        self._first_ns = self._last_ns = self._count = 0

    def count(self, source: str, time_ns: int, number: int = 1) -> None:
        """Count values up to a time; a new source, or a time line that starts again, begins anew."""
        if source != self.source or time_ns < self._last_ns:
            self.source, self._first_ns, self._count = source, time_ns, 0
        else:
            self._count += number
        self._last_ns = time_ns

    @property
    def hz(self) -> float | None:
        """Rate [1/s], None until it is known."""
        elapsed_s = (self._last_ns - self._first_ns) * 1e-9
        return self._count / elapsed_s if elapsed_s >= RATED_S and self._count else None


class Process:
    """Publishes the statements `inertial_short` and `inertial_long` once a second, and what it learns each minute."""

    def __init__(self, config: Config) -> None:
        self._settings: Settings = config
        if config.grade is None:  # also what was learned is learned over what a sensor of unknown grade may do
            self._settings = Settings.model_validate(with_grade(config.model_dump(exclude_unset=True), DEFAULT_GRADE))
        self.monitor = InertialMonitor(self._settings)
        self.gyroscope = GyroscopeMonitor(self._settings, self.rejects)
        self.drift = DriftMonitor(self._settings, self.rejects)
        self.observer = ObserverMonitor(self._settings)
        self._lesson = WindowCollection(self._settings.profile)
        self._adopted: LearnedGrade | None = None  # of an earlier drive
        self._newest_ns = 0
        self._speed, self._wheels = ChosenSource(speed_choice), ChosenSource()
        self._imus, self._fixes = (
            ChosenSource(imu_choice, SILENCE_TIMEOUT_NS),
            ChosenSource(gnss_choice, SILENCE_TIMEOUT_NS),
        )
        self._solution: NavigationSolution | None = None  # newest with a heading
        self._imu, self._gnss = Rate(), Rate()
        self._paused = False
        self._compared = False  # the profile with this unit
        self._warning: Explanation | None = None  # of a profile for another unit

    @property
    def rejects(self) -> Counter[str]:
        """Rejected input by reason."""
        return self.monitor.rejected

    def handle(self, message: In) -> Iterator[Out]:
        """Use a measurement or a solution; publish with each tick."""
        if isinstance(message, ProcessLoad):
            self._pause(paused=Work.INERTIAL_WINDOWS in message.paused)
        elif not self._paused:
            yield from self._use(message)
        elif isinstance(message, Tick):
            yield from paused_statements(message.now_ns)
        else:
            self._heed(message)

    def _use(self, message: In) -> Iterator[Out]:
        match message:
            case ImuSamples() | GnssFix() | VehicleSpeed() | WheelSpeeds():
                self._measure(message)
            case NavigationSolution() if message.phase in WITH_HEADING:
                self._solution = message
                self.monitor.solution(message)
                self.gyroscope.solution(message)
                self.observer.solution(message)
                self.drift.solution(message)
            case AidingUpdate():
                self.drift.innovation(message)
            case FilterState():
                if is_readable(message):
                    self.monitor.filter_state(message)
                else:
                    self.rejects["filter state of another layout"] += 1
            case LearnedGrade() if not self._newest_ns:  # later ones are its own
                self._adopt(message)
            case Tick():
                yield from self._evaluated(max(self._newest_ns, message.now_ns))
            case _:
                self._heed(message)

    def _heed(self, message: In) -> None:
        """Follow what other processes have decided."""
        match message:
            case ModeState():
                self._follow(message)
            case TrustState():
                self._lesson.heed(message)
                self.monitor.heed(
                    odometer=message.odometer_excluded, imu=message.imu_excluded,
                    in_conflict=message.suspect_since_ns is not None,
                )  # fmt: skip
                self.drift.quiet = message.suspect_since_ns is None
            case _:
                pass

    def _pause(self, *, paused: bool) -> None:
        """Leave out all measurements, or begin again with new windows."""
        if self._paused and not paused:
            self._restart_monitor()
        self._paused = paused

    def _follow(self, mode: ModeState) -> None:
        """Use the sources that `controller.mode` has chosen."""
        for chosen in (self._imus, self._fixes, self._speed):
            chosen.follow(mode)

    def _measure(self, message: Measured) -> None:
        """Use a measurement of the source in use."""
        match message:
            case ImuSamples() if self._is_chosen(message):
                self._use_samples(message)
            case GnssFix() if self._is_chosen(message):
                self._gnss.count(message.source, message.sampled_ns)
                self.monitor.fix(message.sampled_ns, *velocity_of(message), *position_of(message))
                self.gyroscope.fix(message, *velocity_of(message))
            case VehicleSpeed() if self._speed.takes(message.source, message.received_ns):
                if self.monitor.odometer(message.sampled_ns, message.speed_m_s, message.resolution_m_s):
                    self.observer.wheels(self._when_of_wheels(message.sampled_ns), message.speed_m_s)
                    self.observer.gravity.speed(self._when_of_wheels(message.sampled_ns), message.speed_m_s)
                self.drift.speed(message.sampled_ns)
            case WheelSpeeds() if self._wheels.takes(message.source, message.received_ns):
                self.gyroscope.speeds(message)
                self.observer.wheels(self._when_of_wheels(message.sampled_ns), fastest(message))
                self.drift.speed(message.sampled_ns)

    def _when_of_wheels(self, time_ns: int) -> int:
        """When a speed with a stamp was true."""
        return time_ns - round(self._settings.long.odometer_delay_s * 1e9)

    def _evaluated(self, time_ns: int) -> Iterator[Out]:
        """Publish both statements, and once a minute what this drive has taught."""
        if not self._compared:
            self._compare_profile()
        self.monitor.learning = self._learning()
        yield from statements(self.monitor.verdicts(time_ns), time_ns, self._warning)
        yield self._of_yaw(time_ns)
        self.monitor.taken.clear()
        sums = self.drift.verdicts(time_ns)
        yield statement("drift", deciding(sums.values()), time_ns, sums)
        self._lesson.add(time_ns, self.monitor.window, self.monitor.long_statistics.values())
        if self._lesson.is_due(time_ns) and (origin := self.origin) is not None:
            yield self._lesson.result(time_ns, origin)

    def _of_yaw(self, time_ns: int) -> TrustMonitor:
        """Statement of the monitor `gyroscope`: windows of up to 30 s, and of up to 300 s against the observer."""
        self.observer.courses(self.gyroscope.new_courses())
        self.observer.advance(self.monitor.taken)
        if self._solution is not None:
            self.gyroscope.observed = self.observer.reference(self._solution.latitude_deg)
        rates = self.gyroscope.verdicts(time_ns, self.monitor.taken)
        turns = self.observer.verdicts(time_ns, self.gyroscope.of_wheels)
        tests = agreed({**rates, **turns})
        return statement("gyroscope", deciding(tests.values()), time_ns, tests)

    @property
    def origin(self) -> Origin | None:
        """Device and configuration of this unit, None until the rates are known."""
        if self._imu.hz is None or self._gnss.hz is None:
            return None
        return Origin(
            imu=self._imu.source, gnss=self._gnss.source, imu_rate_hz=self._imu.hz, gnss_rate_hz=self._gnss.hz,
            configuration=self._settings.digest(), code="", drives=(),
        )  # fmt: skip

    def _compare_profile(self) -> None:
        """Warn once where the profile was learned for another device or configuration."""
        learned = self._settings.profile.origin
        present = None if learned is None else self.origin
        if learned is None or present is None:
            return
        self._compared = True
        different = learned.differences(present)
        if not different:
            return
        what, code = "the profile", Code.PROFILE_OF_ANOTHER_UNIT
        if self._adopted is not None:  # what another device has taught is worth nothing
            what, code = "what was learned", Code.LEARNED_OF_ANOTHER_UNIT
            self._adopted = None
            self._settings = self._settings.model_copy(
                update={"profile": profile_of(self._settings.grade or DEFAULT_GRADE)}
            )
            self._restart_monitor()
        self._warning = explain(code, differences=tuple(different))
        log.warning(
            "%s is of another unit: %s; learn one with `obu calibrate spoofing`", what, "; ".join(different.values())
        )  # fmt: skip

    def _adopt(self, learned: LearnedGrade) -> None:
        """Take the thresholds that an earlier drive has taught, unless the vehicle's file names a profile."""
        if self._settings.profile.origin is not None and self._adopted is None:
            return
        try:
            profile = profile_of_learned(learned)
        except ValueError:  # of a version with other metrics
            self.rejects["learned grade of another version"] += 1
            return
        self._adopted = learned
        self._settings = self._settings.model_copy(update={"profile": profile})
        self._restart_monitor()

    def _learning(self) -> Explanation | None:
        """Why nothing is evaluated yet; None where grade or profile are known."""
        known = self._settings.grade is not None or self._settings.profile.origin is not None
        return None if known else self._lesson.progress

    def _restart_monitor(self) -> None:
        self.monitor = InertialMonitor(self._settings, self.rejects)
        self.gyroscope = GyroscopeMonitor(self._settings, self.rejects)
        self.drift = DriftMonitor(self._settings, self.rejects)

    def _is_chosen(self, message: ImuSamples | GnssFix) -> bool:
        """Whether a message comes from the one source of its kind that is used."""
        chosen = self._imus if isinstance(message, ImuSamples) else self._fixes
        if chosen.takes(message.source, message.received_ns):
            return True
        self.rejects[f"{type(message).__name__} of a second source"] += 1
        return False

    def _use_samples(self, batch: ImuSamples) -> None:
        if batch.saturated:
            self.rejects["imu: saturated"] += 1
            return
        if self._newest_ns - batch.sampled_ns[-1] > RESTART_NS:
            self._restart(batch.sampled_ns[-1])
        self._imu.count(batch.source, batch.sampled_ns[-1], len(batch.sampled_ns))
        self.monitor.inertial(batch.sampled_ns, batch.specific_force_body_m_s2, batch.angular_rate_body_rad_s)
        self._newest_ns = max(self._newest_ns, batch.sampled_ns[-1])
        if batch.pressure_pa is not None:
            self.monitor.pressure(batch.sampled_ns[-1], batch.pressure_pa)
        if batch.magnetic_field_body is not None and self._solution is not None:
            self.gyroscope.field(batch.sampled_ns[-1], batch.magnetic_field_body, self._solution)

    def _restart(self, time_ns: int) -> None:
        """Start again with what was counted, because the time line has started again earlier."""
        self._restart_monitor()
        self.observer = ObserverMonitor(self._settings)
        self.rejects["time line started again"] += 1
        self._newest_ns = time_ns


def velocity_of(fix: GnssFix) -> tuple[Vector3 | None, Vector3 | None]:
    """Velocity [m/s, NED] and standard deviation; of speed and course, as phones give them, the vertical is unknown."""
    if fix.fix_type not in MEASURED:
        return None, None
    if fix.velocity_ned_m_s is not None or fix.ground_speed_m_s is None or fix.course_rad is None:
        return fix.velocity_ned_m_s, fix.velocity_sd_ned_m_s
    speed, course = fix.ground_speed_m_s, fix.course_rad
    return (speed * cos(course), speed * sin(course), 0.0), (0.0, 0.0, UNKNOWN_VERTICAL_SD)


def position_of(fix: GnssFix) -> tuple[Geodetic | None, float]:
    """Position on the ellipsoid, and its horizontal standard deviation [m]."""
    if fix.latitude_deg is None or fix.longitude_deg is None:
        return None, 0.0
    sd_m = DEFAULT_SD_M if fix.position_sd_ned_m is None else max(fix.position_sd_ned_m[:2])
    return Geodetic(radians(fix.latitude_deg), radians(fix.longitude_deg), 0.0), sd_m

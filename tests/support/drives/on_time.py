"""A drive as a timeline receives it: samples, and measurements with their times of arrival."""

from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from enum import Enum
from functools import cache
from itertools import groupby
from math import radians

import numpy as np

from services.core.fusion.aids.base import Measurement, Outcome
from services.core.fusion.aids.gnss.fix import Reading, Stamp, gnss_measurements
from services.core.fusion.aids.odometer.aid import WheelSpeed
from services.core.fusion.inertial.imu_faults import Sample
from services.core.fusion.messages import solution_message
from services.core.fusion.settings import Settings
from services.core.fusion.solution import UncertaintyCache, solution_of
from services.core.fusion.start.heading import Prior
from services.core.fusion.timeline.timeline import Timeline
from services.sensors.simulator.drive import Drive, simulate
from shared.maths.earth import Geodetic

SECOND_NS = 1_000_000_000
BEGIN_S, END_S = 14.0, 24.0  # it drives off at 16 s
SAMPLE_DELAY_NS = 2_000_000


@dataclass(frozen=True)
class Delivery:
    """Measurements of one message, and when it reaches the timeline."""

    reaches_ns: int
    measurements: Sequence[Measurement]

    @property
    def time_ns(self) -> int:
        """When they were true."""
        return self.measurements[0].time_ns

    @property
    def received_ns(self) -> int:
        """When they arrived at the driver."""
        return self.measurements[0].received_ns


@cache
def drive() -> Drive:
    return simulate("parking_lot", seed=2, duration_s=END_S, epoch_s=0.2)


@cache
def settings() -> Settings:
    changes: dict[str, object] = {"vehicle.gnss.lever_arm_body_m": drive().lever_arm_b, "alignment.levelling_s": 1.0}
    return Settings().with_values(changes)


@cache
def samples(begin_s: float = BEGIN_S, end_s: float = END_S) -> tuple[Sample, ...]:
    d = drive()
    rows = zip(d.t_ns.tolist(), d.force_b.tolist(), d.rate_b.tolist(), strict=True)
    return tuple(
        Sample(t, (f[0], f[1], f[2]), (w[0], w[1], w[2]))
        for t, f, w in rows if begin_s * SECOND_NS < t <= end_s * SECOND_NS
    )  # fmt: skip


def fix(k: int, late_ns: int, after_ns: int = 0) -> Delivery:
    """Fix of an epoch that arrives late, and reaches the timeline some time after."""
    d = drive()
    latitude, longitude, height = d.fix_position[k].tolist()
    stamp = Stamp(int(d.fix_ns[k]), int(d.fix_ns[k]) + late_ns, "gnss")
    north, east, down = d.fix_velocity_n[k].tolist()
    place, moving = Reading((0.0, 0.0, 0.0)), Reading((north, east, down))
    made = gnss_measurements(settings(), stamp, Geodetic(latitude, longitude, height), place, moving)
    return Delivery(stamp.received_ns + after_ns, made)


def speed(k: int, late_ns: int, after_ns: int = 0) -> Delivery:
    """Speed of the wheels that arrives late, and reaches the timeline some time after."""
    return speed_at(int(drive().odometer_ns[k]), float(drive().odometer[k]), late_ns, after_ns)


def speed_at(time_ns: int, value: float, late_ns: int, after_ns: int = 0) -> Delivery:
    """The same of any time [ns] and value [m/s]."""
    made = WheelSpeed(time_ns, time_ns + late_ns, "wheels", value, 0.0, True, True, settings())
    return Delivery(time_ns + late_ns + after_ns, (made,))


def epochs(begin_s: float = BEGIN_S, end_s: float = END_S) -> list[int]:
    """Indices of the fixes within a time."""
    return [k for k, t in enumerate(drive().fix_ns.tolist()) if begin_s * SECOND_NS < t <= end_s * SECOND_NS]


def wheel_stamps(begin_s: float = BEGIN_S, end_s: float = END_S) -> list[int]:
    """Indices of the speeds within a time."""
    return [k for k, t in enumerate(drive().odometer_ns.tolist()) if begin_s * SECOND_NS < t <= end_s * SECOND_NS]


@dataclass(frozen=True)
class TimelineRun:
    """A timeline after its input, and what it told."""

    timeline: Timeline
    published: tuple[bytes, ...]
    outcomes: tuple[Outcome, ...]
    lags_ns: tuple[int, ...]


def play(deliveries: Iterable[Delivery], among: Sequence[Sample] | None = None, *, every: int = 10) -> TimelineRun:
    """Give samples as they come, and each delivery before the first sample that arrives later; solve now and then."""
    timeline = Timeline(settings(), Counter())
    place = Geodetic(*drive().position[0].tolist())
    timeline.use_prior(Prior(place, (1.0, 1.0, 2.0), float(drive().attitude[0, 2]), radians(1.0)))
    waiting = sorted(deliveries, key=lambda d: d.reaches_ns)
    cache, published, outcomes, lags = UncertaintyCache(settings()), list[bytes](), list[Outcome](), list[int]()
    used = 0
    for number, sample in enumerate(samples() if among is None else among):
        received_ns = sample.time_ns + SAMPLE_DELAY_NS
        while used < len(waiting) and waiting[used].reaches_ns < received_ns:
            for measurement in waiting[used].measurements:
                timeline.measure(measurement)
            used += 1
        timeline.add(sample)
        if number % every == 0 and (solution := solution_of(timeline.now, cache)) is not None:
            published.append(solution_message(solution).model_dump_json().encode())
        outcomes += timeline.advance(received_ns)
        lags.append(timeline.horizon.lag_ns)
    return TimelineRun(timeline, tuple(published), tuple(outcomes), tuple(lag for lag, _ in groupby(lags)))


def contents(thing: object) -> object:
    """All that an object and the objects in it hold, as plain values that compare to the last bit."""
    match thing:
        case np.ndarray():
            return thing.dtype.str, thing.shape, thing.tobytes()
        case tuple() | list():
            return [type(thing).__name__, *map(contents, thing)]
        case dict():
            return {key: contents(value) for key, value in thing.items()}
    slots = [name for kind in type(thing).__mro__ for name in getattr(kind, "__slots__", ())]
    held = {**getattr(thing, "__dict__", {}), **{name: getattr(thing, name) for name in slots if hasattr(thing, name)}}
    if not held or isinstance(thing, type | Enum | Settings):
        return thing
    return type(thing).__name__, {name: contents(value) for name, value in held.items()}


def differences(one: object, other: object, path: str = "") -> list[str]:
    """Places at which the contents of two objects differ; pytest takes minutes to show those of an engine."""
    if isinstance(one, dict) and isinstance(other, dict) and one.keys() == other.keys():
        return [place for key in one for place in differences(one[key], other[key], f"{path}.{key}")]
    if isinstance(one, list | tuple) and isinstance(other, list | tuple) and len(one) == len(other):
        pairs = enumerate(zip(one, other, strict=True))
        return [place for k, (a, b) in pairs for place in differences(a, b, f"{path}[{k}]")]
    return [] if one is other or one == other else [path]

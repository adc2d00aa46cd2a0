"""Drives of the simulator with the unit as it is delivered: its start, its standstills, its wheels, its margins."""

from bisect import bisect_right
from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from benchmarks.given import fixes_of
from cli.papers.navigation import YAW_SD, saved_heading
from services.core.fusion.inertial.propagation import samples_of
from services.core.fusion.navigator import Navigator
from services.core.fusion.settings import Settings
from services.core.fusion.timeline.log import order
from services.sensors.simulator.drive import EPOCH_NS, STEP_NS, Drive, simulate
from services.sensors.simulator.gnss.gnss_errors import InjectedError
from services.sensors.simulator.imu.imu_errors import MTI_630_ACCELEROMETER, MTI_630_GYROSCOPE, SensorErrors
from services.sensors.simulator.scenarios import scenario_of, with_error
from services.sensors.simulator.vehicle import Stream

from .sizes import INNOVATIONS, FloatArray, Sizes, error_of, innovation_size, sizes_of

SETTLED = 5  # epochs after the filter has started


@dataclass(frozen=True)
class Unit:
    """A kind of drive, and settings that are not the delivered ones."""

    error: InjectedError
    changes: Mapping[str, object] = field(default_factory=dict)


def run(unit: Unit, scenario: str, seed: int, duration_s: float) -> Sizes:
    """Drive once; the errors of epoch k stand in row k - 1, without a number where there is no solution."""
    drive = simulate(with_error(scenario_of(scenario, seed), unit.error), seed, duration_s)
    settings = Settings().with_values({"vehicle.gnss.lever_arm_body_m": drive.lever_arm_b, **unit.changes})
    navigator = Navigator(settings)
    navigator.use_prior(saved_heading(drive, YAW_SD))
    engine, biases = navigator.engine, true_biases(drive)
    samples = samples_of(drive.t_ns, np.hstack([drive.force_b, drive.rate_b]), {})
    due = sorted(fixes_of(drive, settings), key=order)
    epochs = len(drive.t_ns) * STEP_NS // EPOCH_NS
    errors, innovations = np.full((epochs, 6), np.nan), np.full((epochs, 2), np.nan)
    here = used = started = 0
    for k in range(epochs):
        stop = (k + 1) * EPOCH_NS // STEP_NS - 1
        until = bisect_right(due, int(drive.t_ns[stop]), used, key=lambda m: m.time_ns)
        outcomes = engine.process(samples.part(here, stop + 1), due[used:until])
        here, used, navigation = stop + 1, until, engine.filter
        started = started + 1 if navigation else 0
        if navigation is None or started < SETTLED:
            continue
        navigation.propagate_covariance()
        errors[k] = sizes_of(navigation, error_of(navigation, drive, stop, biases[stop]))
        innovations[k] = [innovation_size(outcomes, kind) for kind in INNOVATIONS]
    return Sizes(np.arange(1.0, epochs + 1.0), errors, innovations)


def true_biases(drive: Drive) -> FloatArray:
    """Biases of accelerometer and gyroscope, without the noise beside them, shape (n, 6)."""
    moving = np.zeros(len(drive.t_ns), dtype=np.bool_)
    triads = ((MTI_630_ACCELEROMETER, Stream.ACCELEROMETER), (MTI_630_GYROSCOPE, Stream.GYROSCOPE))
    quiet = [(replace(grade, density=0.0, vibration=0.0), stream) for grade, stream in triads]
    return np.hstack([SensorErrors(grade, STEP_NS * 1e-9, (drive.seed, s)).advance(moving) for grade, s in quiet])

"""Solutions do not depend on when, and how often, they are polled."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cache
from math import nan, radians
from typing import Any

import numpy as np
import pytest

from services.core.fusion.aids.base import Outcome
from services.core.fusion.navigator import Navigator
from services.core.fusion.settings import Settings
from services.core.fusion.start.heading import Prior
from services.sensors.simulator.drive import Drive, simulate
from shared.maths.earth import Geodetic

CLOCK_STEP_SEEDS = (1,)  # seeds of drives with a clock that is set back by 0.3 s
Polling = Callable[[int], bool]  # whether the solution is polled after a sample
POLLED = np.random.default_rng(0).random(5_000) < 0.02
ALWAYS: Polling = lambda _: True  # noqa: E731  # shorter than a function with a name of its own
NEVER: Polling = lambda _: False  # noqa: E731
SOMETIMES: Polling = lambda k: bool(POLLED[k])  # noqa: E731


@dataclass(frozen=True)
class Step:
    """A received sample, and the indices of the fixes and speeds that are received with it."""

    time_ns: int
    force: list[float]
    rate: list[float]
    received_ns: int
    saturated: bool
    fixes: list[int]
    speeds: list[int]


@cache
def drive() -> Drive:
    return simulate("parking_lot", seed=3, duration_s=45.0, epoch_s=0.5)


@cache
def faulty_input(seed: int) -> list[Step]:
    """Samples that are lost, doubled, swapped, stuck, impossible or saturated; fixes and speeds with random delays."""
    d, rng = drive(), np.random.default_rng(seed)
    places = [i for i in range(len(d.t_ns)) for _ in range(1 + (rng.random() < 0.003))]
    for _ in range(4):
        first = int(rng.integers(500, len(places) - 400))
        del places[first : first + int(rng.choice([3, 30, 250]))]
    for k in rng.integers(1, len(places), 8).tolist():
        places[k - 1], places[k] = places[k], places[k - 1]
    stuck = int(rng.integers(1000, 3500))
    set_back = int(rng.integers(2000, 4000)) if seed in CLOCK_STEP_SEEDS else len(places)
    fix_at = np.searchsorted(d.t_ns, d.fix_ns + rng.choice([80e6, 300e6, 1.2e9], len(d.fix_ns)).astype(np.int64))
    speed_at = np.searchsorted(d.t_ns, d.odometer_ns + rng.choice([5e6, 50e6, 400e6], len(d.odometer_ns)).astype(int))
    steps = []
    for k, i in enumerate(places):
        force, rate = d.force_b[i].tolist(), d.rate_b[i].tolist()
        if stuck <= i < stuck + 150:
            force = d.force_b[stuck].tolist()
        if rng.random() < 0.001:
            force[0] = float(rng.choice([nan, 1e9]))
        back_ns = 300_000_000 if k >= set_back else 0
        time_ns, odd = int(d.t_ns[i]) - back_ns, bool(rng.random() < 0.002)
        due = (np.flatnonzero(fix_at == i).tolist(), np.flatnonzero(speed_at == i).tolist())
        steps.append(Step(time_ns, force, rate, int(d.t_ns[i]) + 2_000_000, odd, *due))
    return steps


def results(seed: int, polling: Polling, **changes: object) -> Iterator[Any]:
    """Solution, state, counters and outcomes of a navigator after a faulty drive during which it was polled.

    Without protection levels: these are computed when the covariance is first read, up to one period late.
    """
    d = drive()
    made = Settings().with_values(
        {"vehicle.gnss.lever_arm_body_m": d.lever_arm_b, "alignment.levelling_s": 2.0, **changes}
    )
    navigator = Navigator(made)
    navigator.use_prior(Prior(Geodetic(*d.position[0].tolist()), (1.0, 1.0, 2.0), d.attitude[0, 2], radians(1.0)))
    outcomes: list[Outcome] = []
    for k, step in enumerate(faulty_input(seed)):
        for j in step.fixes:
            navigator.fix(
                int(d.fix_ns[j]),
                position=Geodetic(*d.fix_position[j].tolist()),
                velocity=tuple(d.fix_velocity_n[j].tolist()),
                position_sd=tuple(d.fix_position_sd_n[j].tolist()),
                velocity_sd=tuple(d.fix_velocity_sd_n[j].tolist()),
                received_ns=step.received_ns,
            )
        for j in step.speeds:
            navigator.speed(int(d.odometer_ns[j]), float(d.odometer[j]), received_ns=step.received_ns)
        sample = step.time_ns, step.force, step.rate, step.received_ns
        navigator.advance(*sample, saturated=step.saturated)
        if polling(k):
            navigator.solution()
        outcomes += navigator.release(step.received_ns)
    solution = navigator.solution()
    outcomes += navigator.release(step.received_ns)
    assert solution is not None
    yield from (solution.time_ns, solution.position, solution.velocity, solution.roll, solution.pitch, solution.yaw)
    yield from (cov.tolist() for cov in (solution.position_cov, solution.velocity_cov, solution.attitude_cov))
    yield from (solution.gnss_age_s, navigator.phase, navigator.since_ns, navigator.why, navigator.counts)
    yield from (navigator.samples_used, navigator.samples_rejected, navigator.measurements_late, navigator.rejects)
    yield navigator.lever_arm_error
    # An outcome that was published before a late fix was received is not published again; one that was not published
    # yet is computed anew with that fix. The same holds for fixes with future stamps, after a clock was set back.
    of_devices = [outcome for outcome in outcomes if outcome.source in ("gnss", "wheels")]
    keys = [(outcome.time_ns, outcome.source, outcome.kind) for outcome in of_devices]
    yield sorted(keys if seed in CLOCK_STEP_SEEDS else of_devices, key=repr)


@pytest.mark.parametrize(("seed", "polling"), [(3, ALWAYS), (2, SOMETIMES)])
def test_solutions_do_not_depend_on_polling(seed: int, polling: Polling) -> None:
    unpolled = list(results(seed, NEVER))
    assert list(results(seed, polling)) == unpolled
    assert len(unpolled[-1]) > 300, "outcomes of GNSS and odometer"


@pytest.mark.parametrize(
    ("seed", "changes"),
    [(1, {"history_s": 0.2}), (2, {"history_s": 1.0})],
)
def test_solutions_do_not_depend_on_polling_with_a_short_history(seed: int, changes: dict[str, object]) -> None:
    unpolled = list(results(seed, NEVER, **changes))
    assert list(results(seed, ALWAYS, **changes)) == unpolled
    assert len(unpolled[-1]) > 100

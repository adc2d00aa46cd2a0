"""Many steps in one call: the result is that of the same steps one by one, and rows survive as arrays."""

from functools import cache
from typing import NamedTuple

import numpy as np
import pytest

from services.core.fusion.aids.base import Outcome
from services.core.fusion.aids.non_holonomic.aid import ConstraintModel
from services.core.fusion.aids.odometer.aid import OdometerModel
from services.core.fusion.aids.updates import Model
from services.core.fusion.inertial import error_model as em
from services.core.fusion.inertial.propagation import ImuErrors, Intervals, State
from services.core.fusion.inertial.row import PARAMETERS, Row, packed, row_of
from services.core.fusion.inertial.standstill import StandstillState
from services.core.fusion.navigator import Navigator
from services.core.fusion.settings import Settings
from services.core.fusion.smoothing.history import HistoryRecorder, Record
from services.core.fusion.timeline.segment import Rules, constants_of, rules_of
from services.sensors.simulator.drive import Drive, simulate
from shared.inertial.strapdown import LocalEarth
from shared.maths.earth import Geodetic
from shared.messages.navigation import AidingKind

FALSE_SPEED_S, FALSE_SPEED_M_S = (40.0, 46.0), 60.0  # speeds that are rejected for so long that the velocity inflates


class Records(list[Record]):
    """Records of a history, of which nothing is looked at."""

    push = list.append

    def cut(self, count: int) -> None:
        del self[count:]


@cache
def drive() -> Drive:
    return simulate("urban", 1, 70.0)


class Run(NamedTuple):
    navigator: Navigator
    outcomes: list[Outcome]


@cache
def run(*, step_by_step: bool) -> Run:
    """A drive with standstills, bends, and speeds that are false for a while; a history has each step looked at."""
    d = drive()
    nav = Navigator(Settings().with_values({"vehicle.gnss.lever_arm_body_m": tuple(d.lever_arm_b)}))
    nav.bank.pause(paused=True)
    if step_by_step:
        nav.record_history(HistoryRecorder(Records(), 100_000_000))  # type: ignore[arg-type]  # what is asked of it
    outcomes, k, j = [], 0, 0
    for i, now_ns in enumerate(d.t_ns.tolist()):
        outcomes += nav.imu(now_ns, d.force_b[i].tolist(), d.rate_b[i].tolist())
        while j < len(d.odometer_ns) and d.odometer_ns[j] <= now_ns:
            false = FALSE_SPEED_S[0] <= now_ns * 1e-9 < FALSE_SPEED_S[1]
            speed = FALSE_SPEED_M_S if false else abs(float(d.odometer[j]))
            nav.speed(int(d.odometer_ns[j]), speed, received_ns=now_ns)
            j += 1
        while k < len(d.fix_ns) and d.fix_ns[k] <= now_ns:
            nav.fix(
                int(d.fix_ns[k]), position=Geodetic(*d.fix_position[k].tolist()),
                velocity=d.fix_velocity_n[k].tolist(), received_ns=now_ns,
            )  # fmt: skip
            k += 1
    return Run(nav, outcomes)


def test_one_call_has_the_result_of_the_same_steps_one_by_one() -> None:
    fast, slow = run(step_by_step=False), run(step_by_step=True)
    a, b = fast.navigator.engine.filter, slow.navigator.engine.filter
    assert a is not None and b is not None and a.time_ns == b.time_ns
    sd = np.sqrt(b.P.diagonal()[b.P.diagonal() > 0.0])
    assert np.sqrt(a.P.diagonal()[b.P.diagonal() > 0.0]) == pytest.approx(sd, rel=1e-9)
    north, east = (np.array(a.position[:2]) - np.array(b.position[:2])) * 6.4e6
    assert np.hypot(north, east) < 1e-9 * sd[em.POSITION].min() + 1e-8, "a latitude has a resolution of a nanometre"
    assert a.velocity == pytest.approx(b.velocity, abs=1e-9)
    assert a.parameters == pytest.approx(b.parameters, abs=1e-9)


def test_every_update_has_the_same_outcome_in_the_same_order() -> None:
    fast, slow = run(step_by_step=False).outcomes, run(step_by_step=True).outcomes
    decided = [[(o.time_ns, o.source, o.kind, o.used, o.reason, o.measurement) for o in each] for each in (fast, slow)]
    assert decided[0] == decided[1]
    for a, b in zip(fast, slow, strict=True):
        assert a.innovation == pytest.approx(b.innovation, abs=1e-8)
        assert a.innovation_sd == pytest.approx(b.innovation_sd, rel=1e-9) and a.weight == b.weight
    kinds = {outcome.kind for outcome in fast}
    assert kinds >= {AidingKind.ZERO_VELOCITY, AidingKind.ZERO_ANGULAR_RATE, AidingKind.NON_HOLONOMIC}
    rejected = [outcome for outcome in fast if outcome.kind is AidingKind.ODOMETER and not outcome.used]
    assert len(rejected) > 20, "so that the velocity was inflated"


def test_corrections_of_the_heading_check_are_those_of_all_updates() -> None:
    fast, slow = (run(step_by_step=way).navigator.engine.aids.gate.corrections for way in (False, True))
    assert fast.time_ns == slow.time_ns and abs(fast.velocity - slow.velocity) < 1e-8
    assert abs(fast.tilt - slow.tilt) < 1e-8 and fast.yaw == pytest.approx(slow.yaw, abs=1e-9)


def test_a_row_is_the_same_after_it_was_arrays() -> None:
    numbers = iter(np.random.default_rng(3).normal(size=200).tolist())

    def three() -> tuple[float, float, float]:
        return next(numbers), next(numbers), next(numbers)

    earth = LocalEarth(*three(), *three())
    quiet = StandstillState(three(), three(), next(numbers), three())
    state = State(
        7, (next(numbers), *three()), three(), three(), earth, three(), three(), three(), three(), *three(), three(),
        three(), quiet, next(numbers), three(), next(numbers),
    )  # fmt: skip
    parameters = np.array([next(numbers) for _ in range(em.SIZE - em.DRIVING)])
    row = Row(state, np.eye(em.SIZE), ImuErrors(three(), three(), three(), three()), parameters, three())
    time_ns, values, P = packed(row)
    again = row_of(time_ns, values.tolist(), P, values[PARAMETERS:])
    assert again.state == row.state and again.imu == row.imu and again.P is row.P
    assert again.position_correction == row.position_correction and (again.parameters == parameters).all()


def test_rules_are_the_same_after_they_were_an_array() -> None:
    a, d, e, f, g, h, i, j, k, m, n, o, p, q, r, s = np.random.default_rng(4).uniform(1.0, 2.0, 16).tolist()
    noise = em.ProcessNoise(np.ones(em.SIZE), np.ones(em.SIZE), np.ones(em.SIZE), a)
    model = Model((d, e, f), ConstraintModel(g, h, i), OdometerModel(j, k), (m, n, o))
    rules = Rules(noise, model, Intervals(p, q, r, s, covariance_at_end=True))
    assert rules_of(constants_of(rules), noise.psd, noise.correlation_s, noise.variance) == rules

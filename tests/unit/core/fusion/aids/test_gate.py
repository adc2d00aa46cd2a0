"""Faulty positions of a receiver: rejection, reduced weights and readmission."""

from copy import copy, deepcopy
from dataclasses import dataclass, replace
from functools import cache
from math import radians

import numpy as np
import pytest

from services.core.fusion.aids.base import Height, Outcome
from services.core.fusion.aids.gate import Gate, _weight
from services.core.fusion.aids.gnss.correlated import GNSS_ERROR, POSITION
from services.core.fusion.aids.gnss.faults import FaultStatus
from services.core.fusion.aids.gnss.fix import GnssPosition
from services.core.fusion.aids.gnss.gate import GnssGate
from services.core.fusion.aids.gnss.position_errors import HYPOTHESES, SCALES, UNKNOWN_ERRORS
from services.core.fusion.codes import Code
from services.core.fusion.inertial import error_model as em
from services.core.fusion.inertial.filter import ErrorStateFilter
from services.core.fusion.integrity.error_monitor import ErrorMonitor, block
from services.core.fusion.navigator import Navigator
from services.core.fusion.settings import AlignmentSettings, GatingSettings, Settings
from services.core.fusion.start.heading import Prior
from services.sensors.simulator.drive import Drive, simulate
from shared.maths.earth import Geodetic, geodetic_from_ned_difference, ned_from_geodetic_difference
from shared.messages.navigation import AidingKind
from shared.runtime.config import GnssAntenna, Vehicle

Shift = tuple[float, float, float]
FAULT_S, END_S = 36.0, 60.0
SECOND_NS = 1_000_000_000
SETTINGS = Settings()
EXACT = {"vehicle.gnss.lever_arm_sd_m": 0.0, "gnss.delay_sd_s": 0.0}  # as the set-up of the drive is


@cache
def drive() -> Drive:
    return simulate("parking_lot", seed=2, duration_s=END_S, epoch_s=0.2)


@dataclass
class Run:
    navigator: Navigator
    outcomes: list[Outcome]
    errors: dict[float, np.ndarray]
    levels: dict[float, tuple[float, float]]

    def worst_m(self, begin_s: float, end_s: float) -> float:
        return max(float(np.hypot(*e[:2])) for t, e in self.errors.items() if begin_s <= t < end_s)

    def positions(self, begin_s: float, end_s: float) -> list[Outcome]:
        return [
            o for o in self.outcomes if o.kind is AidingKind.GNSS_POSITION and begin_s * 1e9 <= o.time_ns < end_s * 1e9
        ]


@cache
def run(shift: "Fault", **changes: object) -> Run:
    """Process the drive with positions (and not velocities) moved by a fault."""
    before = fault_free(**changes)
    result = Run(deepcopy(before.navigator), list(before.outcomes), dict(before.errors), dict(before.levels))
    return process(result, shift, FAULT_S - 1.0, END_S)


@cache
def fault_free(**changes: object) -> Run:
    """Process the drive until a second before the fault."""
    d = drive()
    made = Navigator(
        Settings().with_values(
            EXACT | {"vehicle.gnss.lever_arm_body_m": d.lever_arm_b, "alignment.levelling_s": 2.0, **changes}
        )
    )
    made.use_prior(Prior(Geodetic(*d.position[0].tolist()), (1.0, 1.0, 2.0), float(d.attitude[0, 2]), radians(1.0)))
    return process(Run(made, [], {}, {}), Fault(0.0), 0.0, FAULT_S - 1.0)


def process(result: Run, shift: "Fault", begin_s: float, end_s: float) -> Run:
    """Process a part of the drive; keep errors and protection levels ten times a second."""
    d, made = drive(), result.navigator
    k = int(np.searchsorted(d.fix_ns, begin_s * 1e9, side="right"))
    for i in range(round(begin_s * 100), round(end_s * 100)):
        time_ns = int(d.t_ns[i])
        if k < len(d.fix_ns) and d.fix_ns[k] <= time_ns:
            north, east, down = d.fix_velocity_n[k].tolist()
            made.fix(
                time_ns,
                position=geodetic_from_ned_difference(shift(time_ns * 1e-9), Geodetic(*d.fix_position[k].tolist())),
                velocity=(north, east, down),
                position_sd=d.fix_position_sd_n[k].tolist(),
                velocity_sd=d.fix_velocity_sd_n[k].tolist(),
            )
            k += 1
        result.outcomes += made.imu(time_ns, d.force_b[i].tolist(), d.rate_b[i].tolist())
        solution = made.solution() if i % 10 == 0 else None
        if solution:
            truth = Geodetic(*d.position[i].tolist())
            result.errors[time_ns * 1e-9] = np.array(ned_from_geodetic_difference(solution.position, truth))
            levels = solution.protection_level_horizontal, solution.protection_level_vertical
            result.levels[time_ns * 1e-9] = levels
    return result


@dataclass(frozen=True)
class Fault:
    """A shift of positions [m, NED] from `FAULT_S` on."""

    length_s: float
    north_m: float = 0.0
    down_m: float = 0.0

    def __call__(self, time_s: float) -> Shift:
        if not 0.0 <= time_s - FAULT_S < self.length_s:
            return 0.0, 0.0, 0.0
        return self.north_m, 0.0, self.down_m


LAG_S = 0.45  # of the horizon behind a solution, at most


@pytest.mark.parametrize("fault", [Fault(0.1, 30.0), Fault(4.0, 30.0), Fault(4.0, 500.0)], ids=["one", "4 s", "far"])
def test_a_temporary_jump_is_rejected_and_costs_less_than_0_6_m(fault: Fault) -> None:
    found = run(fault)
    assert found.worst_m(FAULT_S, END_S) < 0.6
    assert found.navigator.counts.resets == 0
    during = found.positions(FAULT_S, FAULT_S + fault.length_s)
    assert during and all(o.reason == "beyond the gate" and o.weight == 0.0 for o in during)


def test_after_a_fault_positions_are_used_again_once_they_have_agreed_for_a_second() -> None:
    found = run(Fault(4.0, 30.0))
    back = found.positions(FAULT_S + 4.0, END_S)
    waiting = [o for o in back if o.reason == "not admitted again yet"]
    assert 4 <= len(waiting) <= 7, "one second at 5 Hz"
    assert back[: len(waiting)] == waiting and all(o.used for o in back[len(waiting) :])


def test_after_a_single_outlier_the_next_position_is_used() -> None:
    found = run(Fault(0.1, 30.0))
    assert all(o.used for o in found.positions(FAULT_S + 0.15, END_S))


def test_the_time_before_readmission_doubles_with_each_fault_and_is_reset_after_a_minute() -> None:
    """Faults of 3 s: 1, 2, 4 and 8 s; after more than a minute without a fault 1 s again."""
    second, standing, time_ns = 1_000_000_000, FaultStatus(), 0
    needed: list[float] = []
    for pause_s in (10, 10, 10, 100, 10):
        for _ in range(30):
            time_ns += second // 10
            standing = standing.after(time_ns, agrees=False, settings=SETTINGS)
        assert standing.excluded
        begin_ns = time_ns
        while standing.excluded:
            time_ns += second // 10
            standing = standing.after(time_ns, agrees=True, settings=SETTINGS)
        needed.append(round((time_ns - begin_ns) * 1e-9 - 0.1, 3))
        time_ns += pause_s * second
    assert needed == [1.0, 2.0, 4.0, 8.0, 1.0]


def test_a_disagreement_before_readmission_restarts_the_time_of_agreement() -> None:
    standing = FaultStatus(excluded=True, faults=1)
    standing = standing.after(0, agrees=True, settings=SETTINGS)
    standing = standing.after(900_000_000, agrees=False, settings=SETTINGS)
    standing = standing.after(1_100_000_000, agrees=True, settings=SETTINGS)
    assert standing.excluded and standing.agreeing_since_ns == 1_100_000_000


@pytest.mark.slow
def test_robust_weights_have_smaller_errors_in_bursts_than_a_hard_gate_or_full_weight() -> None:
    """Multipath of 1.5 and 2.5 m for 3 s. The largest error is 1.0 m, with a hard gate 1.2 m, with full weight more."""
    sizes = (1.5, 2.5)
    choices: list[dict[str, float]] = [
        {},
        {"gating.robust_limit": 1.0},
        {"gating.robust_limit": 1.0, "gating.false_alarm_probability": 1e-12},
    ]
    robust, hard, ungated = (
        max(run(Fault(3.0, size), **choice).worst_m(FAULT_S, END_S) for size in sizes) for choice in choices
    )
    assert robust < hard < ungated
    weights = [o.weight for o in run(Fault(3.0, 1.5)).positions(FAULT_S, FAULT_S + 3.0)]
    assert any(0.0 < weight < 1.0 for weight in weights)


def test_a_permanent_jump_resets_the_filter_and_states_the_reason() -> None:
    found = run(Fault(60.0, 500.0))
    assert found.navigator.counts.resets == 1
    assert found.navigator.why[-1].code == Code.POSITIONS_REJECTED
    assert found.errors[max(found.errors)][0] == pytest.approx(500.0, abs=2.0)


class AlternatingHeights(Fault):
    """Heights above the ellipsoid and above mean sea level in turn, 47 m apart, 2 s each."""

    def __call__(self, time_s: float) -> Shift:
        return 0.0, 0.0, -47.0 if time_s > FAULT_S and time_s % 4.0 < 2.0 else 0.0


def test_of_alternating_heights_the_deviating_ones_are_rejected_and_the_horizontal_is_used() -> None:
    found = run(AlternatingHeights(30.0))
    odd = [o for o in found.positions(FAULT_S, END_S) if o.reason]
    assert len(odd) > 50 and all(o.used and "used without it" in (o.reason or "") for o in odd)
    assert found.worst_m(FAULT_S, END_S) < 0.5
    assert max(abs(e[2]) for t, e in found.errors.items() if t > FAULT_S) < 1.5
    assert found.navigator.counts.resets == 0


def test_a_permanent_jump_of_height_is_accepted_without_a_reset() -> None:
    found = height_jump()
    assert found.errors[max(found.errors)][2] == pytest.approx(-47.0, abs=2.0)
    assert found.worst_m(FAULT_S, END_S) < 0.5 and found.navigator.counts.resets == 0
    assert any("height beyond the gate" in (o.reason or "") for o in found.outcomes)


@cache
def height_jump() -> Run:
    """All heights are 47 m too great from 36 s on."""
    return run(Fault(60.0, down_m=-47.0))


def test_a_rejected_height_increases_the_vertical_protection_level_only() -> None:
    found = height_jump()
    (first, *_, last) = [o.time_ns * 1e-9 for o in found.outcomes if o.height]
    during = {t: levels for t, levels in found.levels.items() if first + LAG_S < t < last}
    assert len(during) > 40 and min(vertical for _, vertical in during.values()) > 46.0
    assert max(horizontal for horizontal, _ in during.values()) < 3.0


def test_after_a_height_is_accepted_the_level_holds_the_difference_as_after_a_horizontal_jump() -> None:
    found, level = height_jump(), run(Fault(60.0, north_m=47.0))
    taken_over = next(o.time_ns * 1e-9 for o in found.outcomes if o.height and o.height.taken_over)
    after = [t for t in found.levels if t > taken_over + LAG_S]
    assert all(found.levels[t][1] > abs(found.errors[t][2]) > 45.0 for t in after if t < taken_over + 1.5)
    assert level.levels[after[-1]][0] > 45.0
    assert found.levels[after[-1]][1] > 45.0, "no time decides which of the two heights is right"


def test_a_rejected_height_stays_disputed_until_a_height_is_used() -> None:
    """A horizontal position alone does not end it."""
    twin = copy(filter_with_long_correlation_time())
    twin.propagate_covariance()
    made = Outcome(SECOND_NS, "gnss", AidingKind.GNSS_POSITION, (0.1, 0.1), (1.0, 1.0), 0.1, used=True)
    rejected = made._replace(height=Height(-47.0, 1.0, taken_over=False))
    seen = ErrorMonitor().after(rejected, block(twin), twin, 1e-3, estimated=False, limits_m=(10.0, 20.0))
    assert seen.rejection_bound == (0.0, 47.0)
    seen = seen.after(
        made._replace(time_ns=2 * SECOND_NS), block(twin), twin, 1e-3, estimated=False, limits_m=(10.0, 20.0)
    )
    assert seen.rejection_bound == (0.0, 47.0)
    whole = made._replace(time_ns=3 * SECOND_NS, innovation=(0.1, 0.1, 0.1), innovation_sd=(1.0, 1.0, 1.0))
    assert seen.after(whole, block(twin), twin, 1e-3, estimated=False, limits_m=(10.0, 20.0)).rejection_bound == (
        0.0,
        0.0,
    )
    accepted = rejected._replace(used=False, height=Height(-47.0, 1.0, taken_over=True))
    after = seen.after(accepted, block(twin), twin, 1e-3, estimated=False, limits_m=(10.0, 20.0))
    assert after.held.bound == (0.0, 47.0) and after.rejected_n[2] == 0.0


@pytest.mark.parametrize("seed_settings", [{}, {"gnss.position_only": True}], ids=["velocity", "positions only"])
def test_fewer_than_half_a_percent_of_fault_free_positions_are_rejected(seed_settings: dict[str, object]) -> None:
    found = run(Fault(0.0), **seed_settings)
    positions = found.positions(0.0, END_S)
    assert np.mean([o.reason is not None for o in positions]) < 0.005
    assert not any(o.reason == "not admitted again yet" for o in positions)


@cache
def filter_with_long_correlation_time() -> ErrorStateFilter:
    """Position to 0.2 m; GNSS errors of 3 m estimated to have a correlation time of 200 s."""
    inside = run(Fault(0.0)).navigator.engine.filter
    assert inside is not None
    evidence = UNKNOWN_ERRORS.evidence.copy()
    evidence[:, HYPOTHESES.index((200.0, 0.003)), SCALES.tolist().index(1.0)] = 100.0
    twin, P = copy(inside), inside.P.copy()
    twin.use_errors(POSITION, replace(UNKNOWN_ERRORS, evidence=evidence))
    twin.parameters = tuple(0.0 for _ in twin.parameters)
    for part, variance in ((em.POSITION, 0.04), (GNSS_ERROR, 0.01)):
        P[part], P[:, part] = 0.0, 0.0
        P[part, part] = variance * np.eye(3)
    twin.P = P
    return twin


def fix_beside(navigation: ErrorStateFilter, north_m: float) -> GnssPosition:
    place, now_ns = geodetic_from_ned_difference((north_m, 0.0, 0.0), navigation.inertial.position), 61 * 10**9
    return GnssPosition(now_ns, now_ns, "gnss", place, 9.0 * np.eye(3), 3, (0.0, 0.0, 0.0), 0.0, time_correlated=True)


def test_a_jump_within_the_stated_accuracy_changes_the_time_correlated_error_and_not_the_position() -> None:
    """As after a change of satellites: the fix is used with full weight."""
    twin = copy(filter_with_long_correlation_time())
    fix = fix_beside(twin, 6.0)
    outcome = GnssGate(SETTINGS).use(Gate(SETTINGS), twin, fix, fix.observe(twin))
    assert outcome.used and outcome.weight == 1.0
    assert twin.parameters_of(GNSS_ERROR)[0] == pytest.approx(2.0, rel=0.02)
    assert abs(twin.position_correction[0] - filter_with_long_correlation_time().position_correction[0]) < 0.1


def test_a_jump_beyond_the_stated_accuracy_is_rejected() -> None:
    twin = copy(filter_with_long_correlation_time())
    fix = fix_beside(twin, 15.0)
    assert not GnssGate(SETTINGS).use(Gate(SETTINGS), twin, fix, fix.observe(twin)).used
    assert twin.parameters_of(GNSS_ERROR)[0] == 0.0


def test_the_time_before_readmission_has_a_maximum() -> None:
    standing, time_ns = FaultStatus(excluded=True, faults=20), 0
    while standing.excluded:
        standing = standing.after(time_ns, agrees=True, settings=SETTINGS)
        time_ns += 100_000_000
    assert time_ns * 1e-9 == pytest.approx(SETTINGS.gating.readmission_max_s + 0.1)


def test_velocities_are_used_while_positions_of_the_same_receiver_are_rejected() -> None:
    """A jump of 500 m; each kind of measurement of each device is excluded and readmitted by itself."""
    found = run(Fault(4.0, 500.0))
    during = [o for o in found.outcomes if FAULT_S * 1e9 <= o.time_ns < (FAULT_S + 5.0) * 1e9]
    velocities = [o for o in during if o.kind is AidingKind.GNSS_VELOCITY]
    assert len(velocities) > 20 and all(o.used for o in velocities)
    assert not any(o.used for o in during if o.kind is AidingKind.GNSS_POSITION)


def test_rejected_positions_increase_the_covariance_by_more_than_an_outage_does() -> None:
    """So that a filter with a wrong position accepts measurements again."""
    rejected, outage = (sd_at_end(position) for position in (Fault(60.0, 500.0), None))
    assert rejected > 1.05 * outage


def sd_at_end(fault: Fault | None) -> float:
    """Standard deviation of the position [m] after four seconds of rejected positions, or of none."""
    d = drive()
    made = Navigator(
        Settings(
            vehicle=Vehicle(gnss=GnssAntenna(lever_arm_body_m=d.lever_arm_b)),
            alignment=AlignmentSettings(levelling_s=2.0),
            gating=GatingSettings(reset_after_s=60.0),
        )
    )
    made.use_prior(Prior(Geodetic(*d.position[0].tolist()), (1.0, 1.0, 2.0), float(d.attitude[0, 2]), radians(1.0)))
    for i, time_ns in enumerate(d.t_ns.tolist()[: round((FAULT_S + 4.0) * 100)]):
        faulty = time_ns >= FAULT_S * 1e9
        if i % 20 == 19 and (fault or not faulty):
            k, shift = i // 20, fault(time_ns * 1e-9) if fault else (0.0, 0.0, 0.0)
            made.fix(
                time_ns,
                position=geodetic_from_ned_difference(shift, Geodetic(*d.fix_position[k].tolist())),
                position_sd=d.fix_position_sd_n[k].tolist(),
            )
        made.imu(time_ns, d.force_b[i].tolist(), d.rate_b[i].tolist())
    solution = made.solution()
    assert solution is not None
    return float(np.sqrt(solution.position_cov[0, 0]))


def test_a_reset_after_rejected_positions_keeps_the_gyroscope_biases() -> None:
    found = run(Fault(60.0, 500.0))
    solution, truth = found.navigator.solution(), (drive().rate_b - drive().ideal_rate_b)[:1000].mean(axis=0)
    assert solution is not None and found.navigator.counts.resets == 1
    assert solution.gyroscope_bias == pytest.approx(truth, abs=2e-4)
    assert found.navigator.why[0].code == Code.STARTED


def test_the_weight_falls_as_the_square_of_what_is_left_to_the_limit() -> None:
    assert _weight(0.3, 9.0) == _weight(1.0, 9.0) == 1.0
    assert _weight(5.0, 9.0) == pytest.approx(0.25) and _weight(7.0, 9.0) == pytest.approx(0.0625)
    assert 0.0 < _weight(9.0, 9.0) < 0.01

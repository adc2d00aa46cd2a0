"""Exclusion and readmission of GNSS: fusion, monitors and verdict on a drive with a drag-off."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import groupby
from math import hypot, radians

import numpy as np
import numpy.typing as npt
import pytest

from services.core.fusion.process import Config, Process
from services.sensors.simulator.drive import Drive, simulate
from shared.maths.earth import Geodetic, ned_from_geodetic_difference
from shared.messages.base import Message
from shared.messages.navigation import AidingKind, AidingUpdate, NavigationSolution, NavigationState
from shared.messages.trust import TrustLevel, TrustState
from tests.support.drives.chain import Chain, attacked
from tests.support.drives.spoofing import SECOND_NS

BEGIN_S, END_S, DURATION_S = 70.0, 100.0, 140.0


@dataclass(frozen=True)
class Errors:
    """Errors and protection levels of solutions."""

    time_s: npt.NDArray[np.float64]
    horizontal_m: npt.NDArray[np.float64]
    level_m: npt.NDArray[np.float64]
    nees: npt.NDArray[np.float64]  # horizontal, two degrees of freedom
    excluded: npt.NDArray[np.bool_]

    def worst_m(self, begin_s: float, end_s: float) -> float:
        """Largest horizontal error within a time."""
        return float(self.horizontal_m[(self.time_s >= begin_s) & (self.time_s < end_s)].max())


def errors_of(drive: Drive, published: Sequence[Message]) -> Errors:
    rows = []
    for message in published:
        if not isinstance(message, NavigationSolution):
            continue
        truth = Geodetic(*drive.position[int(np.searchsorted(drive.t_ns, message.sampled_ns))].tolist())
        here = Geodetic(radians(message.latitude_deg), radians(message.longitude_deg), message.height_ellipsoid_m)
        north, east, _ = ned_from_geodetic_difference(here, truth)
        nn, ne, _, ee, _, _ = message.position_cov_ned_m2
        nees = np.array([north, east]) @ np.linalg.solve(np.array([[nn, ne], [ne, ee]]), [north, east])
        rows.append(
            (
                message.sampled_ns / SECOND_NS, hypot(north, east), message.protection_level_horizontal_m, nees,
                message.gnss_excluded_since_ns is not None and message.gnss_excluded_since_ns <= BEGIN_S * SECOND_NS,
            )
        )  # fmt: skip
    columns = np.array(rows, dtype=np.float64).T
    return Errors(columns[0], columns[1], columns[2], columns[3], columns[4] > 0.5)


@pytest.fixture(scope="module")
def drive() -> Drive:
    return simulate("urban", 1, DURATION_S)


@pytest.fixture(scope="module")
def chain(drive: Drive) -> Chain:
    return Chain(attacked(drive, BEGIN_S, END_S, 0.3, 3.0))


@pytest.fixture(scope="module")
def published(chain: Chain) -> list[Message]:
    return list(chain.run())


@pytest.fixture(scope="module")
def errors(drive: Drive, published: list[Message]) -> Errors:
    return errors_of(drive, published)


def verdicts(published: Sequence[Message]) -> list[TrustState]:
    return [message for message in published if isinstance(message, TrustState)]


def test_the_verdict_is_unsafe_and_dead_reckoning_in_the_attack_and_safe_again_after_it(
    published: list[Message],
) -> None:
    """GNSS is excluded when no other hypothesis survives, and used again soon after it has come back."""
    states = [verdict for verdict in verdicts(published) if verdict.sampled_ns > 40 * SECOND_NS]
    sequence = [level for level, _ in groupby(state.state for state in states)]
    assert sequence[:2] == [TrustLevel.SAFE, TrustLevel.UNSAFE] and sequence[-1] is TrustLevel.SAFE
    first = {
        level: next(state.sampled_ns for state in states if state.state is level) / SECOND_NS for level in sequence
    }
    assert BEGIN_S < first[TrustLevel.UNSAFE] < BEGIN_S + 8.0
    assert first[TrustLevel.DEAD_RECKONING] < BEGIN_S + 12.0
    safe = [state.sampled_ns / SECOND_NS for state in states if state.state is TrustLevel.SAFE]
    assert not [at for at in safe if BEGIN_S + 8.0 < at < END_S]
    assert min(at for at in safe if at > END_S) < END_S + 30.0
    assert not any(state.imu_excluded or state.odometer_excluded for state in states)
    assert {state.row for state in states if state.state is TrustLevel.DEAD_RECKONING} == {5}


def test_position_errors_after_the_roll_back_are_below_3_m_and_within_the_levels(errors: Errors) -> None:
    free = errors.excluded
    assert errors.time_s[free][0] < BEGIN_S + 10.0 and free.sum() > 300
    assert errors.horizontal_m[free].max() < 3.0
    assert (errors.horizontal_m[free] < errors.level_m[free]).all()
    assert errors.nees[free].max() < 13.8, "chi-square, two degrees of freedom, 1e-3"


@pytest.mark.slow
def test_without_the_verdict_the_position_error_is_more_than_twenty_times_as_large(
    drive: Drive, errors: Errors
) -> None:
    absorbed = errors_of(drive, list(Chain(attacked(drive, BEGIN_S, END_S, 0.3, 3.0), follow=False).run()))
    assert absorbed.worst_m(BEGIN_S, END_S) > 20.0 * errors.worst_m(BEGIN_S + 10.0, END_S)


def test_excluded_fixes_are_published_with_the_reason_and_counted(published: list[Message]) -> None:
    states = [
        message for message in published if isinstance(message, NavigationState) and message.gnss_excluded_since_ns
    ]
    begin_ns, end_ns = states[5].sampled_ns, states[-1].sampled_ns
    gnss = [
        message
        for message in published
        if isinstance(message, AidingUpdate) and "gnss" in message.kind.value and begin_ns < message.sampled_ns < end_ns
    ]
    assert len(gnss) > 50 and {aiding_update.reason for aiding_update in gnss} == {"GNSS is excluded by core.trust"}
    assert not any(aiding_update.used for aiding_update in gnss)
    assert states[-1].fixes_excluded > 40 and states[-1].resets == 0


def test_the_reason_of_readmission_states_the_distance_from_dead_reckoning(
    published: list[Message], errors: Errors
) -> None:
    reasons = [
        message
        for message in published
        if isinstance(message, NavigationState) and "GNSS is used again" in message.reason
    ]
    assert reasons and "from dead reckoning" in reasons[0].reason
    assert errors.worst_m(reasons[0].sampled_ns / SECOND_NS + 10.0, DURATION_S) < 2.0
    used = [
        message
        for message in published
        if isinstance(message, AidingUpdate)
        and message.kind is AidingKind.GNSS_POSITION
        and message.sampled_ns > reasons[0].sampled_ns
    ]
    assert len(used) > 3 and all(aiding_update.used for aiding_update in used)


@pytest.mark.slow
def test_fusion_publishes_the_same_from_its_recorded_inputs(
    drive: Drive, chain: Chain, published: list[Message]
) -> None:
    fusion = Process(Config().with_values({"vehicle.gnss.lever_arm_body_m": tuple(drive.lever_arm_b)}))
    again = [output for message in chain.consumed for output in fusion.handle(message)]  # type: ignore[arg-type]
    kinds = tuple({type(output) for output in again})
    assert len(kinds) == 7 and again == [message for message in published if isinstance(message, kinds)]


@pytest.mark.slow
def test_a_constant_offset_with_authentic_velocity_is_not_readmitted(drive: Drive) -> None:
    """30 s of drag-off to 3 m/s, then authentic velocities and positions with a constant offset.

    Windows that lie behind the drag-off pass: velocities do not show an offset. The distance from dead reckoning does.
    """
    held = list(Chain(attacked(drive, BEGIN_S, END_S, 0.3, 3.0, held=True)).run())
    states = [verdict for verdict in verdicts(held) if verdict.sampled_ns > (BEGIN_S + 12.0) * SECOND_NS]
    assert all(state.gnss_excluded for state in states)
    passing = {monitor.monitor for monitor in states[-1].monitors if monitor.outcome.value == "pass"}
    assert {"inertial_short", "inertial_long"} <= passing
    ratios = [message.excluded_test_ratio for message in held if isinstance(message, NavigationState)]
    assert ratios[-1] is not None and ratios[-1] > 1.0


@pytest.mark.slow
@pytest.mark.parametrize(
    "failure",
    [
        pytest.param({"dead": (78.0, 86.0)}, id="restart with alignment"),
        pytest.param({"dead": (78.0, 81.0)}, id="warm start"),
        pytest.param({"gap": (93.0, 96.0)}, id="no inertial samples for 3 s"),
    ],
)
def test_no_sensor_is_accused_after_a_gap_or_a_restart(failure: dict[str, tuple[float, float]]) -> None:
    """Solutions just after an alignment have heading errors of degrees, which are no evidence against GNSS."""
    found = verdicts(list(Chain(simulate("urban", 1, 110.0)).run(**failure)))
    assert not any(
        trust_state.gnss_excluded or trust_state.imu_excluded or trust_state.suspect_since_ns for trust_state in found
    )
    if failure.get("dead") == (78.0, 86.0):  # a start in motion: a window has to pass before SAFE
        assert found[-1].state is TrustLevel.CAUTION and found[-1].reason_codes[0].code.startswith("trust.start_")
    else:
        assert found[-1].state is TrustLevel.SAFE

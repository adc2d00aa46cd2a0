"""Solutions of fixes alone: covariance, heading, jumps."""

from math import hypot, pi, radians

import numpy as np
import numpy.typing as npt
import pytest

from services.core.fusion.aids.base import Measurement
from services.core.fusion.aids.gnss.fix import Reading, Stamp, gnss_measurements
from services.core.fusion.hypotheses.gnss_only import GnssOnly
from services.core.fusion.settings import Settings
from services.core.fusion.solution import Solution
from shared.maths.earth import Geodetic, geodetic_from_ned_difference, ned_from_geodetic_difference
from shared.maths.rotation import Vector
from shared.messages.navigation import NavigationPhase
from shared.runtime.config import GnssAntenna, Vehicle

HERE = Geodetic(radians(48.0), radians(11.0), 500.0)
S = 1_000_000_000


def epoch(
    second: float, offset_n: Vector, velocity: Vector | None, sd: float = 1.0, settings: Settings | None = None
) -> list[Measurement]:
    position = geodetic_from_ned_difference(offset_n, HERE)
    at_ns = round(second * S)
    cov = np.diag([sd**2] * 3)
    moving = None if velocity is None else Reading(velocity, np.eye(3) * 0.1**2)
    return gnss_measurements(
        settings or Settings(), Stamp(at_ns, at_ns, "gnss"), position, Reading((0.0, 0.0, 0.0), cov), moving
    )


def solve(model: GnssOnly, measurements: list[Measurement]) -> Solution | None:
    for measurement in measurements:
        model.use(measurement)
    return model.take()


def error_n(solution: Solution, truth_n: Vector) -> npt.NDArray[np.float64]:
    return np.array(ned_from_geodetic_difference(solution.position, geodetic_from_ned_difference(truth_n, HERE)))


def test_a_single_fix_is_published_at_its_stamp_with_unknown_heading() -> None:
    found = solve(GnssOnly(Settings()), epoch(1.0, (1.0, 2.0, 3.0), (0.0, 0.0, 0.0)))
    assert found is not None
    assert (found.time_ns, found.phase) == (S, NavigationPhase.GNSS_ONLY)
    assert np.abs(error_n(found, (1.0, 2.0, 3.0))).max() < 1e-6
    assert found.attitude_cov[2, 2] == pytest.approx(pi**2 / 3.0)
    assert found.stationary


def test_the_lever_arm_is_removed_by_the_course_and_held_in_the_covariance_without_one() -> None:
    settings = Settings(vehicle=Vehicle(gnss=GnssAntenna(lever_arm_body_m=(2.0, 0.0, -1.5))))
    east = solve(GnssOnly(settings), epoch(1.0, (0.0, 2.0, -1.5), (0.0, 10.0, 0.0), 0.05, settings))
    assert east is not None
    assert np.abs(error_n(east, (0.0, 0.0, 0.0))).max() < 1e-6
    unknown = solve(GnssOnly(settings), epoch(1.0, (0.0, 2.0, -1.5), (0.0, 0.0, 0.0), 0.05, settings))
    assert unknown is not None
    error, cov = error_n(unknown, (0.0, 0.0, 0.0)), unknown.position_cov
    assert hypot(error[0], error[1]) > 2.0
    assert float(error[:2] @ np.linalg.solve(cov[:2, :2], error[:2])) < 4.0


@pytest.mark.parametrize("seed", range(3))
def test_errors_twice_as_large_as_stated_are_learned(seed: int) -> None:
    """Normalised error squared per axis is near one after ten minutes, where it would be 4 by what is stated."""
    rng, model = np.random.default_rng(seed), GnssOnly(Settings())
    nees, error = [], np.zeros(3)
    for k in range(900):
        error += (-error / 20.0) + 2.0 * np.sqrt(2.0 / 20.0) * rng.standard_normal(3)
        velocity = (10.0 + 0.1 * rng.standard_normal(), 0.1 * rng.standard_normal(), 0.1 * rng.standard_normal())
        truth = (10.0 * k, 0.0, 0.0)
        place = (truth[0] + error[0], truth[1] + error[1], error[2])
        found = solve(model, epoch(float(k), place, velocity))
        if found is not None and k > 600:
            e = error_n(found, truth)
            nees.append(float(e @ np.linalg.solve(found.position_cov, e)) / 3.0)
    assert len(nees) > 290
    assert 0.3 < np.mean(nees) < 2.0


def test_one_wrong_fix_is_left_out_and_a_place_that_lasts_is_taken_with_both_in_the_covariance() -> None:
    model = GnssOnly(Settings())
    for k in range(10):
        assert solve(model, epoch(float(k), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0))) is not None
    assert solve(model, epoch(10.0, (80.0, 0.0, 0.0), (0.0, 0.0, 0.0))) is None
    assert solve(model, epoch(11.0, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0))) is not None
    late = [solve(model, epoch(12.0 + k, (80.0, 0.0, 0.0), (0.0, 0.0, 0.0))) for k in range(3)]
    assert late[:2] == [None, None]
    assert late[2] is not None
    assert late[2].protection_level_horizontal > 80.0
    assert model.rejected == 3
    after = [solve(model, epoch(15.0 + k, (80.0, 0.0, 0.0), (0.0, 0.0, 0.0))) for k in range(70)]
    assert after[-1] is not None
    assert after[-1].protection_level_horizontal < 20.0


def test_a_reversing_car_keeps_its_heading_and_a_fast_one_does_not_reverse() -> None:
    model = GnssOnly(Settings())
    forward = solve(model, epoch(0.0, (0.0, 0.0, 0.0), (2.5, 0.0, 0.0)))
    solve(model, epoch(1.0, (1.25, 0.0, 0.0), (0.0, 0.0, 0.0)))
    back = solve(model, epoch(2.0, (0.0, 0.0, 0.0), (-3.0, 0.0, 0.0)))
    fast = solve(model, epoch(6.0, (-30.0, 0.0, 0.0), (-12.0, 0.0, 0.0)))
    assert forward is not None and back is not None and fast is not None
    assert forward.yaw == pytest.approx(0.0)
    assert abs(back.yaw) < 0.01
    assert abs(fast.yaw) == pytest.approx(pi)


def test_heading_is_kept_at_standstill_and_forgotten_in_slow_turns() -> None:
    model = GnssOnly(Settings())
    solve(model, epoch(0.0, (0.0, 0.0, 0.0), (0.0, 2.5, 0.0)))
    parked = [solve(model, epoch(1.0 + k, (0.0, 1.25, 0.0), (0.0, 0.0, 0.0))) for k in range(60)]
    assert parked[0] is not None and parked[-1] is not None
    assert parked[0].attitude_cov[2, 2] < radians(20.0) ** 2, "the way of braking"
    assert parked[-1].attitude_cov[2, 2] == parked[0].attitude_cov[2, 2]
    creeping = [solve(model, epoch(61.0 + k, (0.0, 1.25 + k, 0.0), (0.0, 1.0, 0.0))) for k in range(8)][-1]
    assert creeping is not None
    assert creeping.attitude_cov[2, 2] > radians(80.0) ** 2


def test_without_velocities_differences_of_positions_give_speed_and_course() -> None:
    model = GnssOnly(Settings())
    found = [solve(model, epoch(float(k), (0.0, 15.0 * k, 0.0), None, 0.3)) for k in range(5)][-1]
    assert found is not None
    assert found.velocity[1] == pytest.approx(15.0, abs=0.01)
    assert found.yaw == pytest.approx(0.5 * pi, abs=0.01)
    assert found.velocity_cov[1, 1] ** 0.5 > 0.4


def test_stamps_that_do_not_advance_are_not_used() -> None:
    model = GnssOnly(Settings())
    assert solve(model, epoch(5.0, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0))) is not None
    assert solve(model, epoch(5.0, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0))) is None
    assert solve(model, epoch(4.0, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0))) is None


def test_each_receiver_has_the_lever_arm_of_its_antenna() -> None:
    antennas = GnssAntenna(lever_arm_body_m=(1.0, 0.0, 0.0), lever_arms_body_m={"rear": (-2.0, 0.0, 0.0)})
    settings, stamp = Settings(vehicle=Vehicle(gnss=antennas)), Stamp(S, S, "rear/nmea")
    made = gnss_measurements(settings, stamp, HERE, Reading((0.0, 0.0, 0.0)), Reading((5.0, 0.0, 0.0)))
    assert [getattr(measurement, "lever_arm") for measurement in made] == [(-2.0, 0.0, 0.0)] * 2  # noqa: B009  # of either kind
    found = solve(GnssOnly(settings), made)
    assert found is not None
    assert error_n(found, (2.0, 0.0, 0.0))[0] == pytest.approx(0.0, abs=1e-6)

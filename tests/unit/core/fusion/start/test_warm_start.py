"""Warm start from a saved state: consistency of the covariance, and rejection of invalid states."""

from collections.abc import Iterator
from copy import copy
from functools import cache
from math import radians

import numpy as np
import numpy.typing as npt
import pytest

from benchmarks.given import fixes_of, speeds_of
from services.core.fusion.codes import Code
from services.core.fusion.inertial import error_model as em
from services.core.fusion.inertial.filter import ErrorStateFilter
from services.core.fusion.inertial.imu_faults import Sample
from services.core.fusion.navigator import Navigator
from services.core.fusion.settings import Settings
from services.core.fusion.start.heading import Prior
from services.core.fusion.start.warm_start import (
    MAX_GAP_S,
    SavedState,
    covariance_of,
    fault,
    fingerprint,
    restored,
    unmeasured_motion,
)
from services.core.fusion.states import LAYOUT
from services.sensors.simulator.drive import Drive, simulate
from shared.maths.earth import Geodetic, ned_from_geodetic_difference
from shared.maths.rotation import ned_from_body
from shared.messages.explanation import explain
from shared.messages.navigation import NavigationPhase
from tests.support.cases import each

FloatArray = npt.NDArray[np.float64]

SAVED_EVERY = 100  # samples, a second
MOVING = slice(0, em.MOVING)


@cache
def drive() -> Drive:
    """A town with stops and bends, and an outage of GNSS from 60 s to 75 s."""
    return simulate("urban", seed=4, duration_s=120.0)


def settings() -> Settings:
    return Settings().with_values({"vehicle.gnss.lever_arm_body_m": drive().lever_arm_b, "alignment.levelling_s": 2.0})


def sample(i: int) -> Sample:
    d = drive()
    return Sample(int(d.t_ns[i]), tuple(d.force_b[i].tolist()), tuple(d.rate_b[i].tolist()), None)


def fed(made: Navigator, first: int, end: int) -> Iterator[tuple[int, Navigator]]:
    """Give a navigator a range of samples, with fixes and wheel speeds; yield after each sample."""
    d = drive()
    due = sorted(fixes_of(d, made.settings) + speeds_of(d, made.settings), key=lambda m: m.time_ns)
    due = [m for m in due if m.time_ns > d.t_ns[first]]
    for i in range(first, end):
        while due and due[0].time_ns <= d.t_ns[i]:
            made.measure(due.pop(0))
        made.imu(*sample(i)[:3])
        yield i, made


@cache
def states() -> dict[int, SavedState]:
    """Saved states of an uninterrupted filter, by the index of the sample."""
    d, made = drive(), Navigator(settings())
    made.use_prior(Prior(Geodetic(*d.position[0].tolist()), (1.0, 1.0, 2.0), float(d.attitude[0, 2]), radians(1.0)))
    found = {}
    for i, navigator in fed(made, 0, len(d.t_ns)):
        if i % SAVED_EVERY == 0 and (saved := navigator.saved_state()):
            found[i] = saved
    assert len(found) > 110
    return found


def errors(navigation: ErrorStateFilter, i: int) -> FloatArray:
    """Estimated minus true attitude, velocity and position, shape (9,)."""
    d = drive()
    turn = navigation.ned_from_body @ ned_from_body(*d.attitude[i].tolist()).T
    psi = 0.5 * np.array([turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]])
    away = ned_from_geodetic_difference(navigation.position, Geodetic(*d.position[i].tolist()))
    return np.concatenate([psi, np.array(navigation.velocity) - d.velocity_n[i], away])


def nees(navigation: ErrorStateFilter, i: int) -> float:
    """Normalised estimation error squared of attitude, velocity and position, divided by nine."""
    navigation.propagate_covariance()
    x = errors(navigation, i)
    return float(x @ np.linalg.solve(navigation.P[MOVING, MOVING], x)) / em.MOVING


def restarted(i: int, gap: int) -> Navigator:
    """Navigator with the saved state of sample i whose first sample is `gap` samples later."""
    made = Navigator(settings())
    made.restore(states()[i], int(drive().t_ns[i + gap]))
    return made


def test_a_state_restored_after_0_01_s_has_the_same_errors_and_covariance() -> None:
    saved = states()[5000]
    again = restored(settings(), saved, sample(5001))
    assert errors(again, 5001) == pytest.approx(errors(led_to(5002), 5001), abs=0.02)
    added = np.diag(again.P)[:9] - np.diag(covariance_of(saved))[:9]
    assert np.sqrt(np.abs(added)).max() < 0.01, "[rad, m/s, m] 0.01 s without samples"


@cache
def led_to(end: int) -> ErrorStateFilter:
    """Filter without a restart."""
    d, made = drive(), Navigator(settings())
    made.use_prior(Prior(Geodetic(*d.position[0].tolist()), (1.0, 1.0, 2.0), float(d.attitude[0, 2]), radians(1.0)))
    for _ in fed(made, 0, end):
        pass
    assert made.now.filter is not None
    return made.now.filter


@pytest.mark.parametrize("gap_s", [1.0, 2.0, 3.0, 4.9])
def test_after_a_gap_the_mean_nees_is_at_most_1_2(gap_s: float) -> None:
    """At all seconds of a drive in a town; a pessimistic covariance is allowed."""
    gap = round(gap_s * 100)
    found = [
        nees(restored(settings(), saved, sample(i + gap)), i + gap)
        for i, saved in states().items()
        if i + gap < len(drive().t_ns)
    ]
    assert 0.03 < np.mean(found) < 1.2
    assert np.quantile(found, 0.95) < 3.0


@pytest.mark.slow
def test_restarted_filters_have_a_mean_nees_below_1_5_and_a_median_error_below_2_m() -> None:
    """Restarts at random times with a fixed seed."""
    rng, found, away_m = np.random.default_rng(11), [], []
    for i in rng.choice([i for i in states() if 500 < i < 10_000], 12, replace=False).tolist():
        gap = int(rng.integers(100, 490))
        end = i + gap + 1000
        for k, navigator in fed(restarted(i, gap), i + gap, end):
            running = navigator.now.filter
            assert running is not None and navigator.counts.resets == 0, "a solution from the first sample on"
            if (k - i - gap) % 200 == 0:
                found.append(nees(copy(running), k))
            if k == end - 1:
                away_m.append(float(np.hypot(*errors(running, k)[6:8])))
    assert np.mean(found) < 1.5
    assert np.quantile(found, 0.95) < 4.0
    assert np.median(away_m) < 2.0


def test_the_first_sample_after_a_warm_start_has_a_solution_and_a_reason() -> None:
    made = restarted(3000, 150)
    made.imu(*sample(3150)[:3])
    solution = made.solution()
    assert solution is not None and solution.time_ns == drive().t_ns[3150]
    assert made.phase is NavigationPhase.NAVIGATING and made.why == (explain(Code.WARM_START, gap_s=1.5),)
    assert solution.protection_level_horizontal > np.hypot(*errors(made.now.filter, 3150)[6:8])  # type: ignore[arg-type]
    assert solution.position_cov[0, 0] > 2.0 * covariance_of(states()[3000])[6, 6]


def test_a_warm_start_during_an_outage_of_gnss_is_coasting() -> None:
    made = restarted(7000, 250)  # in the outage of GNSS since 60 s
    made.imu(*sample(7250)[:3])
    assert made.phase is NavigationPhase.COASTING


def test_biases_and_parameters_are_restored_with_the_state() -> None:
    saved, again = states()[9000], restored(settings(), states()[9000], sample(9100))
    assert again.imu.accelerometer_bias == saved.accelerometer_bias
    assert again.imu.gyroscope_bias == saved.gyroscope_bias
    lasting = [place - em.DRIVING for name in ("odometer_scale", "mounting", "barometer_offset")
               for place in range(em.SIZE)[LAYOUT.place(name)]]  # fmt: skip
    assert np.array(again.parameters)[lasting] == pytest.approx(np.array(saved.parameters)[lasting])
    odometer = LAYOUT.index("odometer_scale"), LAYOUT.index("odometer_scale")
    assert again.P[odometer] == pytest.approx(covariance_of(saved)[odometer], rel=0.02)


def test_saving_does_not_change_the_filter() -> None:
    one, other = restarted(3000, 100), restarted(3000, 100)
    for (_, first), (_, second) in zip(fed(one, 3100, 3600), fed(other, 3100, 3600), strict=True):
        first.saved_state()
        assert first.now.filter is not None and second.now.filter is not None
    assert np.array_equal(one.now.filter.P, other.now.filter.P)  # type: ignore[union-attr]
    assert one.solution().position == other.solution().position  # type: ignore[union-attr]


def test_the_covariance_of_unmeasured_motion_agrees_with_monte_carlo_draws() -> None:
    """Monte Carlo of the two Brownian bridges and the two constants, integrated by sums."""
    rng, span_s, n, runs = np.random.default_rng(3), 2.0, 200, 20_000
    step, g = span_s / n, np.array([-3.0, 10.0])
    times = np.arange(1, n + 1) * step

    def motion(psd: float, variance: float) -> FloatArray:
        walk: FloatArray = np.cumsum(rng.standard_normal((runs, n)) * np.sqrt(psd * step), axis=1)
        bridge: FloatArray = walk - walk[:, -1:] * times / span_s
        moved: FloatArray = bridge + np.sqrt(variance) * rng.standard_normal((runs, 1))
        return moved

    w = motion(0.05, 0.02**2)
    a = np.stack([motion(1.0, 0.25), motion(1.0, 0.25)])
    yaw = np.cumsum(w, axis=1) * step
    velocity = g[:, None, None] * yaw + np.cumsum(a, axis=2) * step
    position = velocity.sum(axis=2) * step
    sampled = np.cov(np.stack([yaw[:, -1], *velocity[:, :, -1], *position]))
    rows = [2, 3, 4, 6, 7]  # yaw; velocity and position on the ground
    expected = unmeasured_motion((10.0, 3.0, 0.0), span_s)[np.ix_(rows, rows)]
    scale = np.sqrt(np.outer(np.diag(expected), np.diag(expected)))
    assert np.abs(sampled - expected).max() < 0.1 * scale.max()
    assert ((sampled - expected) / scale) == pytest.approx(np.zeros((5, 5)), abs=0.04)


def test_the_added_covariance_is_zero_without_a_gap_and_grows_with_its_length() -> None:
    assert not unmeasured_motion((10.0, 3.0, 0.0), 0.0).any()
    grown = [np.diag(unmeasured_motion((10.0, 3.0, 0.0), span_s))[MOVING] for span_s in (0.5, 1.0, 2.0, 4.0)]
    assert (np.diff(grown, axis=0) > 0.0).all()


def invalid(name: str) -> SavedState:
    """State with one invalid value."""
    saved = states()[5000]
    P = covariance_of(saved)
    if name == "indefinite":
        P[6, 7] = P[7, 6] = 2.0 * np.sqrt(P[6, 6] * P[7, 7])
    elif name == "negative":
        P[3, 3] = -P[3, 3]
    elif name == "certain":
        P[3, 3] = 0.0
    elif name == "boundless":
        P[6, 6] = 1e13
    inertial, w = saved.inertial, saved.inertial.quaternion[0]
    if name == "quaternion":
        inertial = inertial._replace(quaternion=(2.0 * w, *inertial.quaternion[1:]))
    elif name == "speed":
        inertial = inertial._replace(velocity=(600.0, 0.0, 0.0))
    parameters = saved.parameters[:-1] if name == "short" else saved.parameters
    read = ((1e6, 0.0, 0.0), saved.sample[1]) if name == "sample" else saved.sample
    upper = tuple(P[np.triu_indices(len(P))].tolist())
    return saved._replace(inertial=inertial, parameters=parameters, sample=read, covariance=upper)


@each(
    ("name", "reason"),
    [
        ("indefinite", "saved state without a positive covariance"),
        ("negative", "saved state without a positive covariance"),
        ("certain", "saved state without a positive covariance"),
        ("boundless", "saved state without a positive covariance"),
        ("quaternion", "implausible saved state"),
        ("speed", "implausible saved state"),
        ("sample", "implausible saved state"),
        ("short", "saved state of another layout"),
    ],
)
def test_an_invalid_state_is_rejected_with_a_counted_reason(name: str, reason: str) -> None:
    made, saved = Navigator(settings()), invalid(name)
    made.restore(saved, int(drive().t_ns[5100]))
    assert made.rejects == {reason: 1}
    made.imu(*sample(5100)[:3])
    assert made.solution() is None and made.phase is NavigationPhase.LEVELLING


@pytest.mark.parametrize(
    ("age_s", "reason"),
    [
        (MAX_GAP_S + 0.1, "saved state too old"),
        (0.0, "saved state from the future"),
        (-1.0, "saved state from the future"),
        (MAX_GAP_S, None),
    ],
)
def test_a_state_too_old_or_from_the_future_is_rejected(age_s: float, reason: str | None) -> None:
    assert fault(states()[5000], settings(), int(drive().t_ns[5000]) + round(age_s * 1e9)) == reason


def test_every_saved_state_of_a_drive_is_valid() -> None:
    assert all(fault(saved, settings(), saved.inertial.time_ns + 10**9) is None for saved in states().values())


def test_other_settings_have_another_fingerprint() -> None:
    changed = settings().with_values({"gnss.delay_s": 0.1})
    assert fingerprint(settings()) == fingerprint(settings()) != fingerprint(changed)

"""Test of a change of scale: rate of false alarms, power, onset, and what is learned."""

from math import sqrt

import numpy as np
import pytest

from services.core.motion_conflict.inertial_speed.bends import Bend
from services.core.motion_conflict.inertial_speed.scale_change import LIMIT, MAX_REFERENCE, BendScale, ScaleChange

SECOND_NS = 1_000_000_000
PERIOD_NS = 40 * SECOND_NS  # between two bends
SD = 0.025  # of a bend, as on real recordings


def bend(k: int, scale: float, odometer: float | None = None) -> Bend:
    return Bend(k * PERIOD_NS, k * PERIOD_NS + 5 * SECOND_NS, scale, SD, scale if odometer is None else odometer)


def driven(scales: list[float], *, seed: int = 1, change: ScaleChange | None = None, first: int = 0) -> ScaleChange:
    rng = np.random.default_rng(seed)
    change = change or ScaleChange(0.02)
    for k, scale in enumerate(scales, first):
        change.add(bend(k, scale + SD * rng.standard_normal()))
    return change


def found_after(scale: float, clean: int, *, seed: int, most: int = 80) -> int | None:
    """Bends of a false scale until it is accused."""
    change = driven([1.01] * clean, seed=seed)
    assert not change.accusing
    rng = np.random.default_rng((seed, 1))
    for k in range(clean, clean + most):
        change.add(bend(k, 1.01 * scale + SD * rng.standard_normal()))
        if change.accusing:
            assert change.change is not None
            assert change.change.suspect_since_ns < clean * PERIOD_NS, "before the first falsified bend"
            return k - clean + 1
    return None


def test_ten_percent_are_found_after_five_bends_and_three_percent_after_forty() -> None:
    large = [found_after(1.10, 60, seed=seed) for seed in range(1, 11)]
    assert all(count is not None and count <= 5 for count in large)
    small = [found_after(1.03, 60, seed=seed) for seed in range(1, 11)]
    assert all(count is not None and count <= 40 for count in small)


def test_without_a_reference_ten_percent_of_a_whole_drive_are_beyond_what_inertial_sensors_are_off() -> None:
    change = driven([1.13] * 40)
    assert change.accusing
    assert not driven([1.04] * 40).accusing, "a scale of the inertial sensors themselves"


def test_a_clean_drive_exceeds_the_limit_at_most_at_the_design_rate() -> None:
    """Twenty drives of 150 bends: the share above 3.5 standard deviations is some percent, above the limit none."""
    rng = np.random.default_rng(3)
    sizes = []
    for seed in range(20):
        change = ScaleChange(0.02)
        offset = float(np.clip(0.02 * rng.standard_normal(), -MAX_REFERENCE, MAX_REFERENCE))
        noise = np.random.default_rng((seed, 2)).standard_normal(150)
        for k in range(150):
            change.add(bend(k, 1.0 + offset + SD * float(noise[k])))
            sizes += [] if change.change is None else [change.change.size]
        assert not change.accusing
    assert 1.0 < float(np.median(sizes)) < 2.0
    assert max(sizes) < LIMIT
    assert float(np.quantile(sizes, 0.99)) < 4.0


def test_a_slow_ramp_is_not_learned() -> None:
    """One percent in fifty bends, up to ten: the reference lags by the window, and is bounded."""
    change = driven([1.0] * 60)
    rng = np.random.default_rng(5)
    for k in range(60, 560):
        change.add(bend(k, min(1.10, 1.0 + 0.0002 * (k - 60)) + SD * rng.standard_normal()))
        if change.accusing:
            break
    assert change.accusing
    assert change.reference.mean <= 1.0 + MAX_REFERENCE


def test_what_is_suspicious_or_frozen_is_not_learned() -> None:
    change = driven([1.0] * 60)
    mean, learned = change.reference.mean, change.learned
    driven([1.10] * 100, change=change, first=60, seed=2)
    assert change.accusing
    assert change.reference.mean == pytest.approx(mean, abs=0.006)
    assert change.learned <= learned + 40, "those before the attack that were in the window"
    frozen = ScaleChange(0.02, frozen=True)
    driven([1.0] * 60, change=frozen)
    assert frozen.learned == 0


def test_an_accusation_ends_with_ten_bends_of_the_former_scale_and_never_by_time() -> None:
    change = driven([1.0] * 60)
    driven([1.08] * 60, change=change, first=60, seed=2)
    assert change.accusing
    driven([1.0] * 5, change=change, first=120, seed=3)
    assert change.accusing, "five bends are too few"
    driven([1.0] * 25, change=change, first=125, seed=4)
    assert not change.accusing
    assert change.change is not None and change.change.size < LIMIT


def test_one_wild_bend_accuses_nobody() -> None:
    change = driven([1.0] * 60)
    change.add(bend(60, 1.6))
    driven([1.0] * 10, change=change, first=61, seed=2)
    assert not change.accusing


def test_the_variance_of_the_mean_holds_the_common_scale_of_the_inertial_sensors() -> None:
    change = driven([1.0] * 5)
    assert change.change is not None
    assert change.change.sd == pytest.approx(sqrt(0.02**2 + SD**2 / 5), rel=0.1)


def test_the_odometer_shows_the_change_or_not() -> None:
    alike = driven([1.0] * 30)
    driven([1.1] * 6, change=alike, first=30, seed=2)
    assert alike.change is not None and alike.change.odometer == pytest.approx(0.1, abs=0.04)
    change = ScaleChange(0.02)
    for k in range(36):
        change.add(bend(k, 1.0 if k < 30 else 1.1, odometer=0.99))
    assert change.change is not None and change.change.odometer == pytest.approx(0.0, abs=1e-9)


def test_memory_is_bounded() -> None:
    change = driven([1.0] * 300)
    assert len(change.window) <= 41


def test_the_next_start_begins_with_what_bends_have_taught() -> None:
    first = driven([1.02] * 25)
    lesson = first.lesson()
    assert lesson is not None and lesson.bends == 15, "the newest ten may hold a change that is not seen yet"
    assert lesson.mean == pytest.approx(1.02, abs=0.01)
    after = ScaleChange(0.02)
    after.adopt(lesson)
    driven([1.02 * 1.06] * 8, change=after, seed=2)
    assert after.accusing
    unlearned = driven([1.02 * 1.06] * 8, seed=2)
    assert not unlearned.accusing, "within what inertial sensors are off"


def test_nothing_is_taught_while_the_scale_is_suspicious_and_nothing_beyond_the_bound() -> None:
    change = driven([1.0] * 30)
    assert change.lesson() is not None
    driven([1.1] * 5, change=change, first=30, seed=2)
    assert change.lesson() is None
    change.adopt(BendScale(1.2, 0.001, None, 1000, 1.0))
    assert change.reference.mean == 1.0 + MAX_REFERENCE
    assert sqrt(change.reference.variance) > 0.001, "the scale is another one at each start"

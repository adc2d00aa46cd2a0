"""A unit that is knocked, a road that climbs, and a vehicle that brakes."""

from collections.abc import Iterator
from math import cos, radians, sin

import numpy as np
import pytest

from services.core.spoofing.grade import Grade
from services.core.spoofing.observer.gravity import Gravity
from services.core.spoofing.process import Config
from shared.inertial.increments import Increment
from shared.maths.earth import STANDARD_GRAVITY as G
from shared.messages.trust import Outcome
from shared.trust.result import Test

STEP_NS = 100_000_000
VARIANCE = radians(0.02) ** 2  # [rad²/s²] of the bias
RATE = 1e-6
ONSET_S = 40.0


def verdicts(
    seconds: float = 70.0, *, roll_deg: float = 0.0, pitch_deg: float = 0.0, climb_s: float = 0.0, brake: float = 0.0
) -> Iterator[Test]:  # fmt: skip
    """Tests, one a second, of a vehicle whose unit is knocked, whose road climbs for some time, or which brakes."""
    gravity, rng = Gravity(Config.model_validate({"grade": Grade.CONSUMER})), np.random.default_rng(1)
    speed, pitch = 20.0, 0.0
    for k in range(round(10 * seconds)):
        t = 0.1 * (k + 1)
        knocked = t > ONSET_S
        climbs = ONSET_S < t <= ONSET_S + climb_s
        rate = radians(5.0) / climb_s if climbs else 0.0
        braking = brake if ONSET_S < t <= ONSET_S + 5.0 else 0.0
        pitch, speed = pitch + 0.1 * rate, speed - 0.1 * braking
        tilt, roll = pitch + radians(pitch_deg) * knocked, radians(roll_deg) * knocked
        force = [G * sin(tilt) - braking, -G * sin(roll) * cos(tilt), -G * cos(roll) * cos(tilt)]
        shaking = 0.3 * rng.standard_normal(3)
        row = [*(force + shaking).tolist(), 0.0, rate, 0.0, 0.1]
        gravity.speed((k + 1) * STEP_NS, speed)
        gravity.advance([Increment(k * STEP_NS, (k + 1) * STEP_NS, row, 0.0, k == 0)], (0.0, 0.0, 0.0))
        if k % 10 == 9:
            yield gravity.verdict(VARIANCE, RATE)


@pytest.mark.parametrize("knock", [{"roll_deg": 4.0}, {"roll_deg": -6.0}, {"roll_deg": 4.0, "pitch_deg": 4.0}])
def test_a_knock_is_found_within_a_quarter_of_a_minute_and_stated_for_a_while(knock: dict[str, float]) -> None:
    found = list(verdicts(**knock))
    accusing = [k + 1 for k, test in enumerate(found) if test.outcome is Outcome.ACCUSES]
    assert accusing and ONSET_S < accusing[0] <= ONSET_S + 15.0
    assert accusing == list(range(accusing[0], len(found) + 1))
    since_ns = found[-1].suspect_since_ns
    assert since_ns is not None and abs(since_ns - ONSET_S * 1e9) <= 5e9
    assert found[-1].accused == ("imu",)


@pytest.mark.parametrize("what", [{}, {"climb_s": 2.0}, {"climb_s": 10.0}, {"brake": 3.0}, {"roll_deg": 0.7}])
def test_neither_a_climb_nor_braking_nor_less_than_a_degree_is_a_knock(what: dict[str, float]) -> None:
    assert all(verdict.outcome is not Outcome.ACCUSES for verdict in verdicts(**what))


def test_without_wheel_speeds_nothing_is_evaluated() -> None:
    gravity = Gravity(Config.model_validate({"grade": Grade.CONSUMER}))
    for k in range(500):
        gravity.advance(
            [Increment(k * STEP_NS, (k + 1) * STEP_NS, [0.0, 0.0, -G, 0.0, 0.0, 0.0, 0.1], 0.0, k == 0)], (0.0,) * 3
        )
    assert gravity.verdict(VARIANCE, RATE).outcome is Outcome.NOT_EVALUATED


def test_a_gap_within_a_second_of_braking_is_no_knock() -> None:
    gravity, speed = Gravity(Config.model_validate({"grade": Grade.CONSUMER})), 20.0
    for k in range(700):
        braking = 3.0 if 400 <= k < 450 else 0.0
        speed -= 0.1 * braking
        gravity.speed((k + 1) * STEP_NS, speed)
        if not 421 <= k < 429:  # nothing of a second but its ends
            row = [-braking, 0.0, -G, 0.0, 0.0, 0.0, 0.1]
            gravity.advance([Increment(k * STEP_NS, (k + 1) * STEP_NS, row, 0.0, k == 0)], (0.0, 0.0, 0.0))
        if k % 10 == 9:
            assert gravity.verdict(VARIANCE, RATE).outcome is not Outcome.ACCUSES

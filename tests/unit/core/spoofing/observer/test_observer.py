"""The observer: bias of a standstill, its growth, and outputs that no GNSS message changes by a bit."""

from collections.abc import Iterator
from math import radians, sqrt

import numpy as np
import pytest

from services.core.spoofing.grade import Grade
from services.core.spoofing.observer.observer import Observer
from services.core.spoofing.process import Config, Process
from services.sensors.simulator.drive import simulate
from shared.inertial.increments import Increment
from shared.messages.base import Tick
from shared.messages.gnss import GnssFix
from tests.support.drives.spoofing import Input, inputs

STEP_NS = 100_000_000
BIAS = (radians(0.2), radians(-0.1), radians(0.3))
INDUSTRIAL = Config.model_validate({"grade": Grade.INDUSTRIAL})


def rows(seconds: float, *, turn: float = 0.0, shaking: float = 0.0, seed: int = 1) -> Iterator[list[float]]:
    """Rows of increments of a level vehicle that turns at a rate [rad/s] and shakes [m/s²]."""
    rng = np.random.default_rng(seed)
    for _ in range(round(10 * seconds)):
        fx, fy = shaking * rng.standard_normal(2)
        noise = 4e-4 * rng.standard_normal(3)
        yield [fx, fy, -9.81, BIAS[0] + noise[0], BIAS[1] + noise[1], BIAS[2] + noise[2] + turn, 0.1]


def driven(*parts: Iterator[list[float]]) -> Observer:
    """Observer after some parts of a drive."""
    observer, k = Observer(INDUSTRIAL), 0
    for part in parts:
        for row in part:
            observer.advance([Increment(k * STEP_NS, (k + 1) * STEP_NS, row, 0.0, k == 0)])
            k += 1
    return observer


def test_a_standstill_gives_the_bias_within_what_it_states() -> None:
    observer = driven(rows(20.0))
    assert observer.bias is not None and observer.newest_ns is not None
    variance = observer.bias_variance(observer.newest_ns)
    assert variance is not None
    assert observer.bias.value == pytest.approx(BIAS, abs=4.0 * sqrt(variance))
    assert sqrt(variance) < radians(0.01)


def test_a_vehicle_that_shakes_or_turns_does_not_stand() -> None:
    assert driven(rows(30.0, shaking=1.0)).bias is None
    assert driven(rows(30.0, turn=0.2)).bias is None


def test_wheels_that_turn_are_no_standstill_however_quiet_the_samples_are() -> None:
    observer = Observer(INDUSTRIAL)
    for k, row in enumerate(rows(20.0)):
        observer.standstills.wheels(k * STEP_NS, turn=True)
        observer.advance([Increment(k * STEP_NS, (k + 1) * STEP_NS, row, 0.0, k == 0)])
    assert observer.bias is None


def test_without_wheels_a_bias_does_not_jump() -> None:
    """A vehicle that rolls evenly through a long bend is quiet, and its rate is no bias."""
    observer = driven(rows(60.0), rows(5.0, shaking=1.0), rows(20.0, turn=0.01))
    assert observer.counts["standstill without wheels: turns"] > 0
    assert observer.bias is not None and observer.bias.value == pytest.approx(BIAS, abs=radians(0.02))


def test_the_variance_grows_with_the_time_since_the_last_standstill() -> None:
    observer = driven(rows(20.0))
    assert observer.newest_ns is not None
    ages = [observer.bias_variance(observer.newest_ns + seconds * 1_000_000_000) for seconds in (0, 60, 600, 3600)]
    known = [age for age in ages if age is not None]
    assert len(known) == len(ages) and known == sorted(known) and known[0] < known[-1]
    walk = INDUSTRIAL.observer.gyroscope_bias_walk_rad_s_sqrt_s**2
    assert known[3] - known[2] == pytest.approx(3000.0 * walk, rel=0.02), "the instability has been reached"


def test_the_yaw_is_the_integral_of_the_turn() -> None:
    observer = driven(rows(30.0), rows(10.0, turn=radians(9.0), shaking=0.3))
    newest = observer.at(observer.newest_ns or 0)
    before = observer.at((observer.newest_ns or 0) - 2_000_000_000)
    assert newest is not None and before is not None and observer.bias is not None
    turned = newest.less(observer.bias.value) - before.less(observer.bias.value)
    assert turned == pytest.approx(radians(18.0), abs=radians(0.1))


def garbled(message: Input, rng: np.random.Generator) -> Input:
    """Replace everything that a fix measures by random numbers."""
    if not isinstance(message, GnssFix):
        return message
    latitude, longitude = rng.uniform(-80.0, 80.0), rng.uniform(-170.0, 170.0)
    north, east, down = rng.normal(0.0, 40.0, 3).tolist()
    return message.model_copy(
        update={"latitude_deg": latitude, "longitude_deg": longitude, "velocity_ned_m_s": (north, east, down)}
    )


def test_with_gnss_replaced_by_garbage_its_outputs_are_the_same_to_the_bit() -> None:
    drive = simulate("urban", 3, 90.0)
    outputs: list[list[tuple[float, ...]]] = []
    for garbage in (False, True):
        process, rng = Process(Config.model_validate({"grade": Grade.INDUSTRIAL})), np.random.default_rng(5)
        said = []
        for message in inputs(drive):
            list(process.handle(garbled(message, rng) if garbage else message))
            if isinstance(message, Tick):
                said.append(process.observer.observer.outputs())
        outputs.append(said)
    assert outputs[0] == outputs[1]
    assert sum(bool(output) for output in outputs[0]) > 45, "it has stood"


@pytest.mark.parametrize(("gap_steps", "keeps"), [(4, True), (10, True), (12, False)])
def test_the_axis_down_outlives_a_short_gap_and_the_yaw_begins_again(gap_steps: int, keeps: bool) -> None:
    observer, k = driven(rows(20.0), rows(5.0, turn=0.2)), 250 + gap_steps
    continuous = True
    for row in rows(2.0, turn=0.2):
        continuous &= observer.advance([Increment(k * STEP_NS, (k + 1) * STEP_NS, row, 0.0, gap_steps > 10)])
        k += 1
    assert not continuous
    assert (observer.down is not None) is keeps and (observer.newest_ns is not None) is keeps

"""Sums of innovations: their limit, the spread that is learned, small drifts, and what a drift must not teach."""

from collections import Counter
from collections.abc import Callable

import numpy as np
import pytest
from scipy.stats import chi2, f

from services.core.spoofing.codes import Code
from services.core.spoofing.drift.innovations import CLIP, InnovationSeconds
from services.core.spoofing.drift.monitor import MAX_DELAY_S, DriftMonitor
from services.core.spoofing.drift.spread import LARGEST, STATED_BLOCKS, Spread, f_limit
from services.core.spoofing.grade import Grade
from services.core.spoofing.process import Config
from services.core.spoofing.settings import Settings
from shared.messages.navigation import AidingKind, AidingUpdate
from shared.messages.trust import Outcome
from shared.trust.result import Test
from tests.support.drives.yaw_rates import NS, solution_of

INDUSTRIAL: Settings = Config(grade=Grade.INDUSTRIAL)
CONSUMER: Settings = Config(grade=Grade.CONSUMER)
KIND = {"velocity": AidingKind.GNSS_VELOCITY, "position": AidingKind.GNSS_POSITION}
Noise = Callable[[int], list[float]]  # normalised innovation of a second, NED
Rows = list[dict[str, Test]]


def update(kind: AidingKind, second: float, z: list[float], sd: float = 0.05) -> AidingUpdate:
    """Innovation of so many standard deviations."""
    return AidingUpdate(
        sampled_ns=round(second * NS), source="gnss0", kind=kind, innovation=tuple(sd * value for value in z),
        innovation_sd=(sd,) * len(z), test_ratio=0.1, used=True,
    )  # fmt: skip


def run(
    noise: Noise, seconds: int, settings: Settings = INDUSTRIAL, *, odometer: bool = False,
    monitor: DriftMonitor | None = None, start: int = 0,
) -> Rows:  # fmt: skip
    """Statements once a second; velocity innovations of `noise`, white ones of the position."""
    monitor, rng = monitor or DriftMonitor(settings, Counter()), np.random.default_rng(99)
    rows = []
    for second in range(start + 1, start + seconds + 1):
        monitor.solution(solution_of(second * NS, 0.0, stationary=False))
        if odometer:
            monitor.speed(second * NS)
        monitor.innovation(update(KIND["velocity"], second, noise(second)))
        monitor.innovation(update(KIND["position"], second, rng.normal(size=3).tolist(), sd=0.5))
        rows.append(dict(monitor.verdicts(second * NS + NS // 2)))
    return rows


def white(seed: int, shift: list[float] | None = None, onset: int = 0) -> Noise:
    """White noise, with a mean after an onset."""
    rng = np.random.default_rng(seed)
    return lambda second: (rng.normal(size=3) + (np.array(shift) if shift and second > onset else 0.0)).tolist()


def first(rows: Rows) -> int | None:
    return next((k for k, row in enumerate(rows, 1) if accusing(row)), None)


def accusing(row: dict[str, Test]) -> list[Test]:
    return [test for test in row.values() if test.outcome is Outcome.ACCUSES]


@pytest.mark.parametrize("dimension", [1, 2])
@pytest.mark.parametrize("freedom", [10, 40, 100])
def test_the_limit_is_the_quantile_of_the_f_distribution(dimension: int, freedom: int) -> None:
    assert f_limit(dimension, freedom, 1e-6) == pytest.approx(f.isf(1e-6, dimension, freedom), rel=1e-6)
    assert f_limit(dimension, 10**7, 1e-3) == pytest.approx(chi2.isf(1e-3, dimension) / dimension, rel=1e-4)


def test_a_sum_exceeds_its_limit_as_often_as_stated_with_a_spread_that_was_learned() -> None:
    """Variance and sums are those of the same correlated process: a first-order one with a time constant of 5 s."""
    rng, rate, above, trials = np.random.default_rng(5), 0.01, 0, 4000
    rho, seconds, blocks = np.exp(-1.0 / 5.0), 30, 20
    drawn = np.empty((trials, blocks + 1, seconds))
    state = rng.normal(size=(trials, blocks + 1))
    for k in range(seconds):
        drawn[:, :, k] = state
        state = rho * state + (1.0 - rho**2) ** 0.5 * rng.normal(size=state.shape)
    for sums in drawn.sum(axis=2).tolist():
        spread = Spread(1, stated=False)
        for item in sums[:blocks]:
            spread.learn((item,), seconds)
        above += spread.ratio((sums[blocks],), seconds, (0,)) > spread.limit(1, rate)
    assert abs(above - trials * rate) < 4.0 * (trials * rate) ** 0.5


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_white_innovations_pass_for_ten_minutes(seed: int) -> None:
    rows = run(white(seed), 600)
    assert first(rows) is None
    assert {row.outcome for row in rows[-1].values()} == {Outcome.PASS}
    assert set(rows[-1]) == {f"{kind}_{length}" for kind in KIND for length in (30, 100, 300)}


@pytest.mark.parametrize(("sds", "within_s"), [(2.0, 30), (1.0, 75), (0.5, 240)])
def test_a_mean_of_a_fraction_of_a_standard_deviation_is_found_from_before_it_began(sds: float, within_s: int) -> None:
    rows = run(white(4, [sds, 0.0, 0.0], onset=200), 200 + within_s)
    found = first(rows)
    assert found is not None and found > 200
    for test in accusing(rows[found - 1]):
        assert test.accused == ("gnss", "imu") and test.suspect_since_ns is not None
        assert test.suspect_since_ns <= 200 * NS


def test_along_the_vehicle_the_odometer_is_named_too_where_there_is_one_and_downwards_it_is_not() -> None:
    along = accusing(run(white(4, [2.0, 0.0, 0.0], onset=60), 100, odometer=True)[-1])
    down = accusing(run(white(4, [0.0, 0.0, 2.0], onset=60), 100, odometer=True)[-1])
    assert {test.accused for test in along} == {("gnss", "imu", "odometer")}
    assert {test.accused for test in down} == {("gnss", "imu")}


def correlated(seed: int, time_s: float) -> Noise:
    """First-order process of variance 1."""
    rng, rho, state = np.random.default_rng(seed), float(np.exp(-1.0 / time_s)), np.zeros(3)

    def noise(_: int) -> list[float]:
        nonlocal state
        state = rho * state + (1.0 - rho**2) ** 0.5 * rng.normal(size=3)
        values: list[float] = state.tolist()
        return values

    return noise


def test_a_low_cost_sensor_is_not_evaluated_before_its_spread_is_learned_and_passes_then() -> None:
    rows = run(correlated(6, 10.0), 900, CONSUMER)
    assert first(rows) is None
    early, late = rows[200]["velocity_30"], rows[-1]["velocity_30"]
    assert early.outcome is Outcome.NOT_EVALUATED and early.why.code == Code.LEARNING_SPREAD
    assert late.outcome is Outcome.PASS and late.statistic is not None


def test_a_drift_teaches_nothing_and_a_slow_rise_of_the_spread_is_bounded() -> None:
    monitor = DriftMonitor(INDUSTRIAL, Counter())
    run(white(7, [2.0, 0.0, 0.0], onset=100), 100 + 300, monitor=monitor)
    learned = monitor._spreads[AidingKind.GNSS_VELOCITY, 30]
    assert learned.variance(0) < 2.0, "4 by the mean alone, times 30 s"
    spread = Spread(5, stated=False)
    for _ in range(200):
        spread.learn((1e6,) * 5, 30)
    assert spread.variance(0) == LARGEST and spread.blocks >= STATED_BLOCKS


def test_it_passes_again_soon_after_the_innovations_do() -> None:
    def noise(second: int) -> list[float]:
        return white(second, [3.0, 0.0, 0.0] if 200 < second <= 260 else None)(second)

    rows = run(noise, 360)
    assert first(rows) is not None
    last = max(k for k, row in enumerate(rows, 1) if accusing(row))
    assert 260 < last <= 260 + 30 + 20, "the sums over 100 and 300 s would remember it for minutes"


def test_one_wild_second_is_no_drift() -> None:
    rows = run(lambda second: [1e5, 1e5, 1e5] if second == 200 else white(second)(second), 330)
    assert first(rows) is None and CLIP < 30.0**0.5


def test_an_alignment_and_missing_seconds_end_the_windows() -> None:
    monitor = DriftMonitor(INDUSTRIAL, Counter())
    run(white(8), 100, monitor=monitor)
    rows = run(white(9), 20, monitor=monitor, start=200)
    assert {row.outcome for row in rows[-1].values()} == {Outcome.NOT_EVALUATED}


def test_the_last_second_before_a_loss_counts_without_waiting_for_the_next_innovation() -> None:
    monitor = DriftMonitor(INDUSTRIAL, Counter())
    run(white(8), 100, monitor=monitor)
    seconds = monitor._innovations[KIND["velocity"]].seconds
    for second in range(101, 101 + MAX_DELAY_S + 1):
        monitor.verdicts(second * NS + NS // 2)
    assert seconds[-1].number == 100


def test_bad_input_is_counted() -> None:
    rejected: Counter[str] = Counter()
    seconds = InnovationSeconds(rejected)
    good = update(KIND["velocity"], 10.0, [1.0, 1.0, 1.0])
    seconds.add(good, 0.0)
    seconds.add(good.model_copy(update={"innovation": (1.0,), "innovation_sd": (1.0,)}), 0.0)
    seconds.add(good.model_copy(update={"innovation": (float("nan"), 1.0, 1.0)}), 0.0)
    seconds.add(good.model_copy(update={"innovation_sd": (0.0, 1.0, 1.0)}), 0.0)
    seconds.add(update(KIND["velocity"], 5.0, [1.0, 1.0, 1.0]), 0.0)
    assert rejected == {
        "aiding: innovation of another layout": 1,
        "aiding: innovation without a standard deviation": 2,
        "aiding: stamp is before that of the second before": 1,
    }
    seconds.complete(11)
    assert [second.mean for second in seconds.seconds] == [pytest.approx((1.0, 1.0, 1.0, 1.0, 1.0))]


def test_axes_of_the_vehicle_are_those_of_its_heading() -> None:
    seconds = InnovationSeconds(Counter())
    seconds.add(update(KIND["velocity"], 10.0, [0.0, 1.0, 0.0]), np.pi / 2.0)
    seconds.complete(11)
    _, east, _, along, across = seconds.seconds[0].mean
    assert (east, along, across) == pytest.approx((1.0, 1.0, 0.0), abs=1e-12)

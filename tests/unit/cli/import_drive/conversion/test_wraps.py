import numpy as np
import pytest

from cli.import_drive.conversion.wraps import unwrapped
from shared.maths.earth import FloatArray
from tests.support.cases import each


def made(period_s: float, step_s: float, before: int = 200, after: int = 200) -> tuple[FloatArray, FloatArray]:
    """The true time around the end of a period, and the clock that starts anew."""
    true = period_s + (np.arange(-before, after) + 0.25) * step_s
    clock: FloatArray = np.where(true >= period_s, true - period_s, true)
    return np.asarray(true), clock


@each(
    ("period_s", "step_s", "name"),
    [
        (604_800.0, 0.02, "a week"), (604_800.0, 1.0, "a week"), (86_400.0, 0.2, "a day"),
        (43_200.0, 1.0, "half a day"), (3600.0, 0.1, "an hour"), (2**32 * 1e-6, 0.01, "2^32 us"),
        (2**32 * 1e-3, 0.01, "2^32 ms"), (2**31 * 1e-6, 0.01, "2^31 us"), (2**16 * 1e-3, 1.0, "2^16 ms"),
        (2**32 * 1e-4, 0.01, "2^32 100 us"),
    ],
)  # fmt: skip
def test_a_clock_goes_on_over_the_end_of_each_known_period(period_s: float, step_s: float, name: str) -> None:
    true, clock = made(period_s, step_s)
    found = unwrapped(clock, np.arange(400.0), None, "imu.csv: the clock 't'")
    assert found.seconds == pytest.approx(true, abs=1e-6)
    assert found.sentences == [
        f"imu.csv: the clock 't' starts anew after {name} at row 201; the stamps were continued."
    ]


def test_a_clock_that_starts_anew_many_times_and_from_negative_values_is_continued() -> None:
    true = np.arange(0.0, 300.0, 0.05)
    period = 2**16 * 1e-3
    clock = (true + period / 2.0) % period - period / 2.0
    found = unwrapped(clock, np.arange(float(len(true))), None, "x")
    assert found.seconds == pytest.approx(true, abs=1e-6)
    assert "and 4 more times" in found.sentences[0]


def test_a_late_row_over_the_end_of_the_week_is_put_back() -> None:
    true, clock = made(604_800.0, 1.0)
    order = np.arange(400)
    order[[199, 200]] = order[[200, 199]]
    assert unwrapped(clock[order], np.arange(400.0), None, "x").seconds == pytest.approx(true[order])


def test_rows_are_missing_at_the_end_of_the_week() -> None:
    true, clock = made(604_800.0, 1.0)
    kept = np.r_[0:100, 300:400]
    assert unwrapped(clock[kept], np.arange(200.0), None, "x").seconds == pytest.approx(true[kept])


def test_a_stated_period_is_continued_whatever_it_is() -> None:
    true, clock = made(1000.0, 0.1)
    found = unwrapped(clock, np.arange(400.0), 1000.0, "x")
    assert found.seconds == pytest.approx(true)
    assert "starts anew after 1000 s at row 201" in found.sentences[0]


def test_a_step_back_that_is_no_known_period_is_named_with_its_row() -> None:
    clock = np.r_[np.arange(0.0, 77.7, 0.1), np.arange(0.0, 20.0, 0.1)]
    found = unwrapped(clock, np.arange(float(len(clock))), None, "imu.csv: the clock 't'")
    assert found.seconds.tolist() == clock.tolist()
    (said,) = found.sentences
    assert said.startswith(
        "imu.csv: the clock 't' steps back by 77.6 s at row 778, the end of no known period: 200 rows"
    )
    assert "`wraps_s`" in said


def test_rows_out_of_order_by_a_few_steps_are_worth_no_sentence() -> None:
    clock = np.arange(0.0, 50.0, 0.1)
    clock[[100, 101]] = clock[[101, 100]]
    found = unwrapped(clock, np.arange(500.0), None, "x")
    assert found.seconds.tolist() == clock.tolist() and not found.sentences

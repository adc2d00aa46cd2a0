"""The harm of exclusions, and the metrics of the verdict, on a circle that is known in closed form."""

from collections.abc import Iterable
from dataclasses import replace

import numpy as np
import pytest

from cli.solve.codes import Code
from cli.solve.metrics.counters import Counters
from cli.solve.metrics.errors import errors_against
from cli.solve.metrics.metrics import METRICS, Run, as_objects, metrics_of
from cli.solve.metrics.trust import TRUST, Trust, harm_of
from cli.solve.report.report import Heading, by_verdict, judgement, summary, verdict, worse_axes
from cli.solve.track import Track
from cli.solve.verdicts import Verdicts
from shared.messages.base import Vector3
from shared.messages.trust import TrustLevel
from tests.support.drives.tracks import RADIUS, RATE, START_NS, reference, solution, track

S = 1_000_000_000
NOWHERE = (0.0, 0.0, 0.0)
TENTHS = [0.1 * k for k in range(301)]
TRUTH = reference([0.25 * k + 0.01 for k in range(118)])


def driven(times_s: Iterable[float], error_n: Vector3 = NOWHERE) -> Track:
    return track(solution(t, error_n=error_n) for t in times_s)


def test_harm_is_the_ratio_of_horizontal_errors_at_the_same_times() -> None:
    harm = harm_of(TRUTH, driven(TENTHS, (0.0, 3.0, 9.0)), driven(TENTHS, (1.5, 0.0, 0.1)), lever_arm_b=NOWHERE)
    assert harm is not None and harm.ratio == pytest.approx(2.0, rel=1e-3)
    same = driven(TENTHS, (1.5, 0.0, 0.1))
    equal = harm_of(TRUTH, same, same, lever_arm_b=NOWHERE)
    assert equal is not None and equal.ratio == 1.0


def test_a_missing_solution_counts_as_the_last_one_held() -> None:
    arm = (1.0, 0.0, 0.0)
    times = [time_s for time_s in TENTHS if time_s < 20.05]
    truth = reference([5.0, 10.0, 25.0], arm_b=arm)
    harm = harm_of(truth, driven(times), driven(TENTHS, (1.0, 0.0, 0.0)), lever_arm_b=arm)
    assert harm is not None
    # From 20 to 25 s the antenna goes on by 1 rad on a circle whose radius is that of the vehicle and the arm.
    chord = 2.0 * np.hypot(RADIUS, arm[0]) * np.sin(0.5 * RATE * 5.0)
    assert harm.with_trust_m == pytest.approx(chord / np.sqrt(3.0), rel=2e-3)
    assert harm.without_trust_m == pytest.approx(1.0, rel=1e-3)


def test_times_before_the_first_solution_or_without_one_in_both_runs_are_not_counted() -> None:
    late = [time_s for time_s in TENTHS if time_s > 9.95]
    gap = [time_s for time_s in TENTHS if not 15.05 < time_s < 20.0]
    truth = reference([5.0, 12.0, 17.5])
    harm = harm_of(truth, driven(late, (2.0, 0.0, 0.0)), driven(gap, (1.0, 0.0, 0.0)), lever_arm_b=NOWHERE)
    assert harm is not None and harm.with_trust_m == pytest.approx(2.0, rel=1e-3), "12 s alone"
    assert harm_of(truth, driven(late), driven(gap), lever_arm_b=NOWHERE, since_ns=START_NS + 13 * S) is None
    assert harm_of(truth, driven(late), track([]), lever_arm_b=NOWHERE) is None
    assert harm_of(replace(truth, geodetic=None), driven(late), driven(gap), lever_arm_b=NOWHERE) is None


def made(times_s: list[float], *, trust: bool = True) -> Run:
    edges = START_NS + np.array([0, 10, 90, 100]) * S
    verdicts = Verdicts(
        edges, (TrustLevel.INITIALISING, TrustLevel.SAFE, TrustLevel.DEAD_RECKONING), np.array([False, False, True])
    )
    solved = driven(times_s, (0.6, 0.0, 0.0))  # the level is 0.5 m
    errors = errors_against(TRUTH, solved, lever_arm_b=NOWHERE)
    run = Run(solved, Counters(), errors, [], START_NS, START_NS + 100 * S, 50, 0)
    return replace(run, trust=Trust(verdicts, 1.5)) if trust else run


def test_metrics_say_the_seconds_of_each_verdict_in_an_object() -> None:
    found = metrics_of(made(TENTHS))
    assert list(found) == list(METRICS)
    objects = as_objects(found)
    assert objects["trust_seconds"] == {
        "safe": 80.0, "caution": 0.0, "unsafe": 0.0, "dead_reckoning": 10.0, "no_fix": 0.0, "initialising": 10.0,
    }  # fmt: skip
    after = objects["trust_seconds_after_60s"]
    assert isinstance(after, dict) and after["safe"] == 30.0 and after["initialising"] == 0.0
    assert objects["gnss_excluded_s"] == 10.0 and objects["harm_ratio"] == 1.5
    assert objects["errors_above_level_horizontal"] == 1.0 and objects["errors_above_level_vertical"] == 0.0


def test_without_core_trust_its_metrics_are_null() -> None:
    objects = as_objects(metrics_of(made(TENTHS, trust=False)))
    assert {objects[name] for name in as_objects(dict.fromkeys(TRUST))} == {None}
    assert objects["without_solution_s"] == 70.0, "that is known without it"


def test_time_without_a_solution_is_counted_between_solutions_and_at_the_end() -> None:
    gaps = [time_s for time_s in TENTHS if not 5.05 < time_s < 9.95 and not 12.05 < time_s < 13.95]
    # 5 to 10 s; 12 to 14 s is not above the limit; 30 to 100 s.
    assert metrics_of(made(gaps))["without_solution_s"] == pytest.approx(75.0)


def test_the_report_says_verdicts_exclusion_harm_and_missing_solutions() -> None:
    found = metrics_of(made(TENTHS))
    assert by_verdict(found) == [
        "Verdict of core.trust: SAFE 80 s, DEAD RECKONING 10 s, INITIALISING 10 s. GNSS was excluded for 10 s.",
        "With core.trust the horizontal error is 1.5 times that without it, at the same times; where the solution is "
        "missing, the last one is held.",
    ]
    said = summary(Heading("drive", "a circle", None, []), found)
    assert "Without a solution for 70 s after the first one; these are in none of the errors." in said
    assert verdict(found).endswith("There is no solution for 70 s.")
    assert by_verdict(metrics_of(made(TENTHS, trust=False))) == []


def test_fusion_is_not_called_worse_than_gnss_alone_where_an_outage_removed_fixes() -> None:
    found = metrics_of(made(TENTHS)) | {
        "gnss_alone_count": 28, "gnss_alone_horizontal_rmse_m": 0.4, "at_fixes_horizontal_rmse_m": 0.6,
    }  # fmt: skip
    assert worse_axes(found) == ["horizontal"] and judgement(found)[0].code == Code.WORSE
    cut = found | {"fixes_removed": 10}
    assert worse_axes(cut) == [] and judgement(cut)[0].code != Code.WORSE
    said = " ".join(summary(Heading("drive", "a circle", "10/30", []), cut))
    assert "worse" not in said and "Receiver only, at the same 28 fixes" in said


def test_outages_without_a_solution_are_not_said_to_be_outside_the_drive() -> None:
    found = metrics_of(made(TENTHS)) | {"outage_count": 0}
    said = " ".join(summary(Heading("drive", "a circle", "10/30", []), found))
    assert "No outage of --outage 10/30 could be evaluated" in said and "lies within the drive" not in said

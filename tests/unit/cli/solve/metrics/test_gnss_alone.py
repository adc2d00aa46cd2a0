"""Errors of the receiver only and of the solution at the same fixes, on a circle that is known in closed form."""

import math
from dataclasses import replace

import numpy as np
import pytest

from cli.solve.metrics.counters import Counters
from cli.solve.metrics.gnss_alone import gnss_alone
from cli.solve.metrics.metrics import METRICS, Run, metrics_of
from cli.solve.report.report import against_gnss
from shared.maths.earth import Geodetic, geodetic_from_ned_difference
from shared.messages.base import Vector3
from shared.messages.gnss import FixType, GnssFix
from tests.support.drives.tracks import START_NS, reference, solution, track

S = 1_000_000_000
ARM = (1.0, 0.5, -1.2)
NOWHERE = (0.0, 0.0, 0.0)
SOLUTIONS = track(solution(0.1 * k, error_n=(0.0, 0.4, 0.0)) for k in range(301))
TRUTH_S = [0.05 * k for k in range(600)]


def fixes(
    *, error_n: Vector3 = (0.3, 0.0, 0.5), late_s: float = 0.0, arm_b: Vector3 = ARM, height: bool = True
) -> list[GnssFix]:
    """Make 1 Hz fixes of the antenna between the epochs of truth and solution."""
    times = [0.517 + k for k in range(28)]
    found = []
    for time_s, place in zip(times, np.asarray(reference(times, arm_b=arm_b).geodetic).tolist(), strict=True):
        seen = geodetic_from_ned_difference(error_n, Geodetic(*place))
        stamp = START_NS + round((time_s + late_s) * S)
        found.append(GnssFix(
            sampled_ns=stamp, received_ns=stamp, source="gnss", fix_type=FixType.THREE_D,
            latitude_deg=math.degrees(seen.latitude), longitude_deg=math.degrees(seen.longitude),
            height_ellipsoid_m=seen.height if height else None,
        ))  # fmt: skip
    return found


def test_both_errors_are_those_at_the_antenna_and_at_the_times_of_the_fixes() -> None:
    found = gnss_alone(fixes(), reference(TRUTH_S), SOLUTIONS, lever_arm_b=ARM, delay_s=0.0)
    assert found is not None and len(found) == 28
    np.testing.assert_allclose(found.gnss_n, np.tile([0.3, 0.0, 0.5], (28, 1)), atol=4e-3)
    np.testing.assert_allclose(found.solution_n, np.tile([0.0, 0.4, 0.0], (28, 1)), atol=4e-3)


def test_a_configured_delay_is_removed_and_another_is_an_error_of_gnss() -> None:
    late = fixes(error_n=NOWHERE, late_s=0.1)
    right = gnss_alone(late, reference(TRUTH_S), SOLUTIONS, lever_arm_b=ARM, delay_s=0.1)
    wrong = gnss_alone(late, reference(TRUTH_S), SOLUTIONS, lever_arm_b=ARM, delay_s=0.0)
    assert right is not None and wrong is not None
    assert np.hypot(*right.gnss_n[:, :2].T).max() < 4e-3
    assert np.hypot(*wrong.gnss_n[:, :2].T) == pytest.approx(1.0, abs=0.02), "0.1 s at 10 m/s, the arm 0.2 m/s more"


def test_a_truth_of_positions_alone_is_interpolated_and_turned_by_the_solution() -> None:
    bare = replace(reference([0.25 * k for k in range(120)]), velocity_n=None, attitude=None)
    found = gnss_alone(fixes(), bare, SOLUTIONS, lever_arm_b=ARM, delay_s=0.0)
    assert found is not None
    np.testing.assert_allclose(found.gnss_n, np.tile([0.3, 0.0, 0.5], (len(found), 1)), atol=6e-3)


def test_a_truth_at_the_antenna_needs_no_lever_arm() -> None:
    found = gnss_alone(fixes(), reference(TRUTH_S, arm_b=ARM), SOLUTIONS, lever_arm_b=ARM, delay_s=0.0)
    assert found is not None
    np.testing.assert_allclose(found.gnss_n[:, :2], np.tile([0.3, 0.0], (len(found), 1)), atol=4e-3)
    np.testing.assert_allclose(found.solution_n[:, :2], np.tile([0.0, 0.4], (len(found), 1)), atol=4e-3)


def test_fixes_outside_the_truth_are_omitted_and_those_without_height_have_no_vertical_error() -> None:
    part = gnss_alone(fixes(), reference(TRUTH_S[:200]), SOLUTIONS, lever_arm_b=ARM, delay_s=0.0)
    assert part is not None and len(part) == 10
    flat = gnss_alone(fixes(height=False), reference(TRUTH_S), SOLUTIONS, lever_arm_b=ARM, delay_s=0.0)
    assert flat is not None and np.isnan(flat.gnss_n[:, 2]).all()
    np.testing.assert_allclose(flat.gnss_n[:, :2], np.tile([0.3, 0.0], (len(flat), 1)), atol=4e-3)
    without = replace(reference(TRUTH_S), geodetic=None)
    assert gnss_alone(fixes(), without, SOLUTIONS, lever_arm_b=ARM, delay_s=0.0) is None


def test_the_metrics_and_one_sentence_say_that_fusion_is_worse() -> None:
    alone = gnss_alone(fixes(), reference(TRUTH_S), SOLUTIONS, lever_arm_b=ARM, delay_s=0.0)
    run = Run(SOLUTIONS, Counters(), None, [], START_NS, START_NS + 30 * S, 28, 0, gnss_alone=alone)
    found = metrics_of(run)
    assert set(found) == set(METRICS) and found["gnss_alone_count"] == 28
    assert found["gnss_alone_horizontal_rmse_m"] == pytest.approx(0.3, abs=4e-3)
    assert found["at_fixes_horizontal_rmse_m"] == pytest.approx(0.4, abs=4e-3)
    assert found["gnss_alone_standstill_horizontal_rmse_m"] is None, "the circle has no standstill"
    sentences = against_gnss(found)
    assert len(sentences) == 2 and "Fusion is worse than the receiver horizontally:" in sentences[1]
    better = metrics_of(replace(run, gnss_alone=None)) | {
        "gnss_alone_count": 28, "gnss_alone_horizontal_rmse_m": 0.5, "at_fixes_horizontal_rmse_m": 0.4,
    }  # fmt: skip
    assert against_gnss(better) == ["Receiver only, at the same 28 fixes: 0.5 m horizontal RMS (fused 0.4 m)."]
    assert against_gnss(metrics_of(replace(run, gnss_alone=None))) == []

import math
from dataclasses import replace

import numpy as np
import pytest

from cli.solve.metrics.counters import Counters
from cli.solve.metrics.drift import drift_lines
from cli.solve.metrics.errors import Errors, errors_against
from cli.solve.metrics.metrics import METRICS, TIMINGS, Run, metrics_of
from cli.solve.outages import Outages
from cli.solve.track import Track
from shared.messages.base import Vector3
from shared.messages.navigation import AidingKind, AidingUpdate, NavigationPhase, NavigationState
from tests.support.drives.tracks import START_NS, circle, reference, solution, track

S = 1_000_000_000
NOWHERE = (0.0, 0.0, 0.0)


def run(made: Track, errors: Errors | None = None, counters: Counters | None = None) -> Run:
    return Run(made, counters or Counters(), errors, [], START_NS, START_NS + 100 * S, 50, 10)


def errors_of(position_n: list[Vector3], *, sd: float = 1.0, period_s: float = 0.25) -> Errors:
    stamps = START_NS + (np.arange(len(position_n)) * period_s * S).astype(np.int64)
    return Errors(stamps, stamps + S // 20, np.array(position_n), np.full((len(position_n), 3), sd), None, None)


def update(innovation: Vector3, *, used: bool = True) -> AidingUpdate:
    return AidingUpdate(
        sampled_ns=START_NS, source="gnss", kind=AidingKind.GNSS_POSITION, innovation=innovation,
        innovation_sd=(0.5, 0.5, 0.5), test_ratio=0.2 if used else 3.0, used=used,
    )  # fmt: skip


def test_every_metric_is_present_and_unknown_ones_are_none() -> None:
    found = metrics_of(run(track(map(solution, (0.0, 1.0)))))
    assert list(found) == list(METRICS)
    assert found["horizontal_rmse_m"] is None and found["outage_count"] is None
    assert found["fixes_recorded"] == 50 and found["fixes_removed"] == 10
    assert found["duration_s"] == 100.0
    assert not set(METRICS) & set(TIMINGS), "times that the computer took are in no file that is compared"


def test_position_error_metrics_have_their_standard_definitions() -> None:
    errors = errors_of([(3.0, 4.0, 1.0), (0.0, 0.0, -1.0), (0.0, 5.0, 1.0), (0.0, 0.0, -1.0)])
    found = metrics_of(run(track([solution(0.0)]), errors))
    assert found["horizontal_rmse_m"] == pytest.approx(math.sqrt((25 + 25) / 4), abs=1e-6)
    assert found["horizontal_max_m"] == 5.0
    assert found["vertical_rmse_m"] == 1.0
    assert found["truth_count"] == 4
    # Twelve components, of which 4 and 5 are beyond three standard deviations of 1.
    assert found["within_3_sigma_fraction"] == pytest.approx(10 / 12, abs=1e-6)


def test_the_mean_heading_error_is_separated_from_its_standard_deviation() -> None:
    yaw = math.pi - 0.05 + np.array([0.1, -0.1, 0.1, -0.1])  # wraps past south
    attitude = np.column_stack([np.zeros(4), np.zeros(4), (yaw + math.pi) % (2 * math.pi) - math.pi])
    errors = replace(errors_of([NOWHERE] * 4), attitude=attitude)
    found = metrics_of(run(track([solution(0.0)]), errors))
    assert found["yaw_mean_error_rad"] == pytest.approx(math.pi - 0.05, abs=1e-6)
    assert found["yaw_sd_rad"] == pytest.approx(0.1, abs=1e-6)
    assert found["roll_rmse_rad"] == 0.0


def test_distance_is_that_of_the_path_without_standstill() -> None:
    moving = [solution(0.1 * k) for k in range(101)]
    found = metrics_of(run(track(moving)))
    assert found["distance_m"] == pytest.approx(100.0, rel=1e-3), "10 m/s for 10 s, along chords"
    still = [made.model_copy(update={"stationary": True}) for made in moving]
    assert metrics_of(run(track(still)))["distance_m"] == 0.0


def test_rejected_fixes_are_counted_and_excluded_from_the_innovation_rms() -> None:
    counters = Counters()
    for item in (update((0.3, 0.4, 0.0)), update((-0.3, 0.4, 0.0)), update((30.0, 40.0, 0.0), used=False)):
        counters.add_update(item)
    counters.add_update(update((9.0, 9.0, 9.0)).model_copy(update={"kind": AidingKind.ZERO_VELOCITY}))
    found = metrics_of(run(track([solution(0.0)]), counters=counters))
    assert (found["fixes_used"], found["fixes_rejected"]) == (2, 1)
    assert found["innovation_horizontal_rms_m"] == pytest.approx(0.5)
    assert found["normalised_innovation_rms"] == pytest.approx(math.sqrt(2 * (0.6**2 + 0.8**2) / 6), abs=1e-6)


def test_alignment_time_is_from_the_first_input_to_the_first_navigating_state() -> None:
    counters = Counters()
    for second, word in ((0, "levelling"), (12, "navigating"), (30, "coasting"), (40, "navigating")):
        counters.add_state(NavigationState(
            sampled_ns=START_NS + second * S, phase=NavigationPhase(word), since_ns=0, reason="", fixes_used=0,
            fixes_rejected=0, samples_used=0, samples_rejected=0, imu_gaps=0, resets=2,
        ))  # fmt: skip
    found = metrics_of(run(track([solution(0.0)]), counters=counters))
    assert found["alignment_s"] == 12.0 and found["filter_resets"] == 2


def test_the_drift_of_an_outage_is_the_error_at_its_last_uncorrected_truth() -> None:
    # The solution drifts by 1 m/s while GNSS is missing from 20 s to 30 s, and is right again from 30 s on.
    def drifting(t: float) -> Vector3:
        return (max(0.0, t - 20.0) if t < 29.999 else 0.0, 0.0, 0.0)

    times = [round(0.1 * k, 1) for k in range(401)]
    made = track(solution(t, error_n=drifting(t)) for t in times)
    outages = Outages.parse("10/30")
    outages.aligned_ns = START_NS
    gaps = outages.gaps(START_NS + 40 * S)
    truth = reference([0.25 * k + 0.01 for k in range(160)])
    errors = errors_against(truth, made, lever_arm_b=NOWHERE)
    found = metrics_of(replace(run(made, errors), gaps=gaps))
    assert found["outage_count"] == 1
    # The last truth of the gap with solutions from within the gap on both sides is at 29.76 s.
    assert found["outage_end_error_median_m"] == pytest.approx(9.76, abs=0.01)
    assert found["outage_largest_error_rms_m"] == pytest.approx(9.76, abs=0.01)
    assert found["outage_largest_error_max_m"] == pytest.approx(9.76, abs=0.01)
    # From the truth at 20.01 s to that at 29.76 s the vehicle goes 97.5 m at 10 m/s; its truth cuts corners by 0.01 %.
    assert found["outage_end_error_share_median"] == pytest.approx(9.76 / 97.5, rel=2e-3)
    lines = list(drift_lines(replace(run(made, errors), gaps=gaps).drifts(), START_NS))
    assert lines[0] == "start_s,end_s,end_error_m,largest_error_m,distance_m\n"
    assert [float(field) for field in lines[1].split(",")] == pytest.approx([20.0, 30.0, 9.76, 9.76, 97.5], abs=0.02)


def test_a_gap_without_a_truth_near_its_end_is_omitted() -> None:
    errors = errors_of([NOWHERE] * 40, period_s=0.25)  # ends after 10 s
    made = replace(run(track([solution(0.0)]), errors), gaps=[(START_NS + 5 * S, START_NS + 15 * S)])
    found = metrics_of(made)
    assert found["outage_count"] == 0 and found["outage_end_error_median_m"] is None


def test_errors_before_score_from_are_excluded_from_means() -> None:
    errors = errors_of([(5.0, 0.0, 0.0)] * 20 + [(0.3, 0.4, 0.0)] * 20, period_s=0.25)
    made = run(track([solution(0.0)]), errors)
    assert metrics_of(replace(made, scored_from_ns=START_NS + 5 * S))["horizontal_rmse_m"] == pytest.approx(0.5)
    assert metrics_of(made)["truth_count"] == 40


def test_errors_before_score_from_are_excluded_from_misleading_information() -> None:
    errors = replace(errors_of([(5.0, 0.0, 0.0)] * 20 + [(0.3, 0.4, 0.0)] * 20, period_s=0.25),
                     protection_m=np.ones((40, 2)))  # fmt: skip
    made = run(track([solution(0.0)]), errors)
    found = metrics_of(replace(made, scored_from_ns=START_NS + 5 * S))
    assert (found["protection_horizontal_judged_count"], found["protection_horizontal_misleading_count"]) == (20, 0)
    assert metrics_of(made)["protection_horizontal_misleading_count"] == 20


def test_attitude_errors_are_also_computed_without_the_mounting() -> None:
    times = [0.1 * k for k in range(300)]
    turned = track(solution(t).model_copy(update={"yaw_rad": circle(t)[2] + 0.07}) for t in times)
    found = metrics_of(run(turned, errors_against(reference(times[1:-1]), turned, lever_arm_b=NOWHERE)))
    assert found["yaw_rmse_rad"] == pytest.approx(0.07, abs=1e-6)
    assert found["mounting_yaw_rad"] == pytest.approx(0.07, abs=1e-6) and found["mounting_roll_rad"] == 0.0
    assert found["yaw_rmse_mounted_rad"] == pytest.approx(0.0, abs=1e-6)

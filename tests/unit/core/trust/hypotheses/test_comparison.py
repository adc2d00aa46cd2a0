"""Solutions of the bank against each other: which of GNSS and odometer contradicts the inertial sensors alone."""

import pytest

from services.core.trust.codes import Code
from services.core.trust.hypotheses.comparison import LIMIT, compared
from shared.messages.explanation import explain
from shared.messages.trust import Hypothesis, HypothesisSolution, Outcome, TrustHypotheses
from shared.words.words import words

ALONE, WITHOUT_GNSS, WITHOUT_ODOMETER = Hypothesis.GNSS_AND_ODOMETER, Hypothesis.GNSS, Hypothesis.ODOMETER


def solution(
    hypothesis: Hypothesis, north_m: float, sd_m: float, *, east_m: float = 0.0, speed: float = 10.0,
    odometer: float | None = None,
) -> HypothesisSolution:  # fmt: skip
    """A solution so far north and east of the published position, of a vehicle that drives north."""
    return HypothesisSolution(
        hypothesis=hypothesis, left_out=(), since_ns=0, latitude_deg=45.0, longitude_deg=9.0, height_ellipsoid_m=0.0,
        velocity_ned_m_s=(speed, 0.0, 0.0), position_cov_ned_m2=(sd_m**2, 0.0, 0.0, sd_m**2, 0.0, 1.0),
        protection_level_horizontal_m=1.0, protection_level_vertical_m=1.0, apart_ned_m=(-north_m, -east_m, 0.0),
        odometer_innovations=odometer,
    )  # fmt: skip


def bank(*solutions: HypothesisSolution) -> TrustHypotheses:
    return TrustHypotheses(sampled_ns=0, source="core.fusion", solutions=solutions)


@pytest.mark.parametrize(
    ("without_gnss_m", "without_odometer_m", "odometer", "outcome", "accused"),
    [
        (0.0, 0.0, 1.0, Outcome.PASS, ()),
        (1.0, 40.0, 1.0, Outcome.ACCUSES, ("gnss",)),
        (40.0, 1.0, 1.0, Outcome.ACCUSES, ("odometer",)),
        (1.0, 1.0, 900.0, Outcome.ACCUSES, ("odometer",)),
        (40.0, 41.0, 1.0, Outcome.ACCUSES, ("imu", "gnss", "odometer")),
        (-40.0, 40.0, 1.0, Outcome.NOT_EVALUATED, ()),
    ],
    ids=["all agree", "GNSS", "odometer", "an odometer that is rejected", "both alike or the IMU", "three ways"],
)
def test_two_of_three_decide(
    without_gnss_m: float, without_odometer_m: float, odometer: float, outcome: Outcome, accused: tuple[str, ...]
) -> None:
    found = compared(
        bank(
            solution(ALONE, 0.0, 3.0, odometer=odometer),
            solution(WITHOUT_GNSS, without_gnss_m, 1.0),
            solution(WITHOUT_ODOMETER, without_odometer_m, 1.0),
        )
    )
    assert (found.outcome, found.accused) == (outcome, accused)
    code = Code.NO_TWO_AGREE if outcome is Outcome.NOT_EVALUATED else Code.SOLUTIONS_COMPARED
    assert found.why is not None and found.why.code == code and words().detail(found.why)
    assert found.why.values["gnss_m"] == abs(without_odometer_m) and found.why.values["speed_statistic"] == odometer


def test_a_difference_across_the_way_decides_nothing_because_a_wrong_heading_makes_one() -> None:
    across = solution(WITHOUT_ODOMETER, 0.0, 1.0, east_m=80.0)
    found = compared(bank(solution(ALONE, 0.0, 3.0), solution(WITHOUT_GNSS, 0.0, 1.0), across))
    assert found.outcome is Outcome.PASS


def test_the_statistic_is_the_distance_over_the_sum_of_both_variances() -> None:
    far = solution(WITHOUT_ODOMETER, 12.0, 4.0)
    found = compared(bank(solution(ALONE, 0.0, 3.0), solution(WITHOUT_GNSS, 0.0, 1.0), far))
    assert found.statistic == pytest.approx(144.0 / 25.0) and found.threshold == LIMIT


@pytest.mark.parametrize("hypothesis", [ALONE, WITHOUT_GNSS, WITHOUT_ODOMETER])
def test_nothing_is_compared_without_all_three_or_at_standstill(hypothesis: Hypothesis) -> None:
    three = [solution(hypothesis, 0.0, 1.0) for hypothesis in (ALONE, WITHOUT_GNSS, WITHOUT_ODOMETER)]
    two = [hypothesis_solution for hypothesis_solution in three if hypothesis_solution.hypothesis is not hypothesis]
    assert compared(bank(*two)).outcome is Outcome.NOT_EVALUATED
    assert compared(bank(*two)).why == explain(Code.NOT_COMPARABLE)
    slow = [solution(hypothesis_solution.hypothesis, 0.0, 1.0, speed=0.5) for hypothesis_solution in three]
    assert compared(bank(*slow)).outcome is Outcome.NOT_EVALUATED
    assert compared(bank(*slow)).why == explain(Code.HARDLY_MOVES)

"""The balance of the demo counts solutions whose error is above their protection level."""

import dataclasses

import pytest

from cli.demo.balance import Balance, Summary
from cli.demo.demo import why_unhealthy
from cli.demo.plaza_balance import PlazaSummary
from cli.demo.words import FIELDS, lines
from shared.messages.gnss import FixType, GnssFix
from shared.messages.imu import ImuRaw
from shared.messages.navigation import NavigationSolution, TruthState
from shared.messages.operation import ProcessHealth, ProcessLoad, ProcessState, Work
from shared.messages.trust import TrustLevel, TrustState
from shared.runtime.config import parse_vehicle
from tests.support.drives.tracks import START_NS, solution


def truth(time_s: float) -> TruthState:
    s = solution(time_s)
    return TruthState(
        sampled_ns=s.sampled_ns,
        latitude_deg=s.latitude_deg,
        longitude_deg=s.longitude_deg,
        height_ellipsoid_m=s.height_ellipsoid_m,
        velocity_ned_m_s=s.velocity_ned_m_s,
        roll_rad=0.0,
        pitch_rad=0.0,
        yaw_rad=s.yaw_rad,
        angular_rate_body_rad_s=s.angular_rate_body_rad_s,
    )


def promised(time_s: float, level: float | None) -> NavigationSolution:
    made = solution(time_s, error_n=(3.0, 4.0, -2.0))
    return made.model_copy(update={"protection_level_horizontal_m": level, "protection_level_vertical_m": level})


def fix(time_s: float, error_east_m: float) -> GnssFix:
    s = solution(time_s, error_n=(0.0, error_east_m, 0.0))
    return GnssFix(
        sampled_ns=s.sampled_ns, received_ns=s.sampled_ns, source="gnss", fix_type=FixType.THREE_D,
        latitude_deg=s.latitude_deg, longitude_deg=s.longitude_deg, height_ellipsoid_m=s.height_ellipsoid_m,
    )  # fmt: skip


@pytest.mark.parametrize(("fused_m", "worse"), [(1.0, False), (3.0, True)])
def test_gnss_alone_and_the_solution_are_compared_at_the_fixes(fused_m: float, worse: bool) -> None:
    balance = Balance(parse_vehicle("[vehicle]\nname = 'truck-07'\n"))
    for k in range(40):
        balance.add("truth/state", truth(0.1 * k), START_NS)
        balance.add("navigation/solution", solution(0.1 * k, error_n=(0.0, fused_m, 0.0)), START_NS)
    for time_s in (0.55, 1.55, 2.55, 30.0):
        balance.add("gnss/fix", fix(time_s, 2.0), START_NS)
    found = balance.summary(alive=1, expected=1, restarts=0)
    assert found.gnss_horizontal_rmse_m == pytest.approx(2.0, abs=0.03), "the chord of the truth is 2 cm short"
    assert found.fusion_at_fixes_horizontal_rmse_m == pytest.approx(fused_m, abs=0.01)
    assert found.fusion_worse_than_gnss is worse


def test_misleading_solutions_are_counted_against_the_truth() -> None:
    """Errors of 5 m on the ground and 2 m in height against levels of 6, 4, 1 m and none; the last has no truth."""
    balance = Balance(parse_vehicle("[vehicle]\nname = 'truck-07'\n"))
    for k in range(6):
        balance.add("truth/state", truth(0.1 * k), START_NS)
    for k, level in enumerate((6.0, 4.0, 1.0, None), 1):
        balance.add("navigation/solution", promised(0.1 * k, level), START_NS)
    balance.add("navigation/solution", promised(9.0, 0.1), START_NS)
    found = balance.summary(alive=1, expected=1, restarts=0)
    assert (found.misleading_horizontal, found.misleading_vertical) == (2, 1)
    assert found.protection_horizontal_median_m == found.protection_vertical_median_m == pytest.approx(4.0)
    assert found.fusion_horizontal_rmse_m == pytest.approx(5.0, abs=0.01)


def test_a_run_that_ends_long_after_the_last_fix_is_not_healthy_and_says_since_when() -> None:
    ready = ProcessHealth(process="core.fusion", state=ProcessState.READY, incarnation=START_NS, sent_ns=START_NS)
    for silent_s, healthy in ((1.0, True), (49.0, False)):
        balance = Balance(parse_vehicle(""), keep=False)
        balance.add("health/core.fusion", ready, START_NS)
        balance.add("navigation/solution", solution(0.1), START_NS)
        balance.add("imu/raw", ImuRaw(received_ns=START_NS, source="imu", data=b"\xfa"), START_NS)
        balance.add("gnss/fix", fix(1.0, 0.0), START_NS)
        end_ns = START_NS + round(silent_s * 1e9)
        balance.add("imu/raw", ImuRaw(received_ns=end_ns, source="imu", data=b"\xfa"), end_ns)
        found = balance.summary(alive=1, expected=1, restarts=0)
        assert (found.healthy, found.without_fix_s) == (healthy, silent_s)
        assert healthy or why_unhealthy(found) == "no GNSS fix with a position for the last 49 s"


@pytest.mark.parametrize("kind", [Summary, PlazaSummary])
def test_every_figure_of_a_summary_has_words_and_none_is_printed_as_python_writes_it(kind: type) -> None:
    names = [field.name for field in dataclasses.fields(kind) if field.name != "attacks"]
    assert set(names) <= set(FIELDS)
    values: dict[str, object] = dict.fromkeys(names, 2) | {
        name: value
        for name, value in {
            "trust": {"safe": 21.0, "no_fix": 5.5, "unsafe": 0.0}, "cpu_share_by_process": {"core.toll": 0.21},
        }.items()
        if name in names
    }  # fmt: skip
    printed = lines(values)
    assert not any("_" in line or "{" in line or "None" in line for line in printed)
    if kind is Summary:
        assert any(line.endswith("  SAFE 21 s, NO POSITION 5.5 s") for line in printed)
    else:
        assert any(line.endswith("  core.toll 21 %") for line in printed)
    assert all(line.endswith("not known") for line in lines(dict.fromkeys(names)))


def verdicts(levels: list[TrustLevel]) -> list[TrustState]:
    """One verdict a second."""
    return [
        TrustState(
            sampled_ns=START_NS + k * 1_000_000_000, state=level, since_ns=START_NS, row=2, reasons=("",),
            gnss_excluded=False, odometer_excluded=False, alert_limit_horizontal_m=10.0, alert_limit_vertical_m=20.0,
        )
        for k, level in enumerate(levels)
    ]  # fmt: skip


@pytest.mark.parametrize(
    ("late_s", "missing_s", "paused_s", "why"),
    [
        (0.01, 0, 0, None),
        (0.01, 30, 0, "not usable: no position for 30 of 99 s; "),
        (7.9, 66, 60, "not usable: this computer is too slow: no position for 66 of 99 s, checks paused for 60 s, "),
        (0.1, 0, 40, "not usable: this computer is too slow: no position for 0 of 99 s, checks paused for 40 s, "),
    ],
)  # fmt: skip
def test_a_run_whose_position_could_not_be_used_is_not_healthy(
    late_s: float, missing_s: int, paused_s: int, why: str | None
) -> None:
    balance, second_ns = Balance(parse_vehicle("")), 1_000_000_000
    ready = ProcessHealth(process="core.fusion", state=ProcessState.READY, incarnation=START_NS, sent_ns=START_NS)
    balance.add("health/core.fusion", ready, START_NS)
    for k in range(100):
        at_ns = START_NS + k * second_ns
        balance.add("imu/raw", ImuRaw(received_ns=at_ns, source="imu", data=b"\xfa"), at_ns)
        balance.add("gnss/fix", fix(float(k), 1.0), at_ns)
        made = solution(float(k))
        balance.add("navigation/solution", made, made.sampled_ns + round(late_s * 1e9))
    for verdict in verdicts([TrustLevel.NO_FIX] * missing_s + [TrustLevel.SAFE] * (100 - missing_s)):
        balance.add("trust/state", verdict, verdict.sampled_ns)
    for time_s, paused in ((0, (Work.HYPOTHESES,)), (paused_s, ())):
        load = ProcessLoad(sampled_ns=START_NS + time_s * second_ns, process="core.fusion", lag_s=0.6, paused=paused)
        balance.add("health/load", load, load.sampled_ns)
    found = balance.summary(alive=1, expected=1, restarts=0)
    assert found.healthy is (why is None)
    assert why is None or why_unhealthy(found).startswith(why)

"""Indicators of drives whose values follow by hand."""

from dataclasses import replace

import numpy as np
import pytest

from cli.kpi.indicators import INDICATORS, NS, DriveObservations, _errors, indicators_of
from cli.kpi.page import page
from cli.solve.metrics.errors import Errors
from cli.solve.metrics.gnss_alone import GnssAlone
from cli.solve.track import Track, TrackBuilder
from cli.solve.verdicts import VerdictLog, Verdicts
from shared.messages.gnss import CarrierSolution
from shared.messages.power import PowerState
from shared.messages.trust import TrustLevel
from tests.support.outputs import fix, satellites, solution, verdict

START_NS = 1_700_000_000 * NS
LEVELS = {"protection_level_horizontal_m": 4.0, "protection_level_vertical_m": 8.0}


def track(seconds: list[float]) -> Track:
    builder = TrackBuilder()
    for second in seconds:
        builder.add(solution(START_NS + round(second * NS), **LEVELS))
    return builder.track().valid()


def verdicts(*levels: tuple[int, TrustLevel], last_s: int = 100) -> Verdicts:
    """A verdict a second; each level holds from its second on."""
    log = VerdictLog()
    for second in range(last_s):
        level = [level for first, level in levels if first <= second][-1]
        log.add(verdict(START_NS + second * NS, level))
    return log.verdicts(START_NS, START_NS + last_s * NS)


def errors(horizontal: list[float], vertical: list[float]) -> Errors:
    """A true state a second, errors to the north and down."""
    stamps = START_NS + NS * np.arange(len(horizontal), dtype=np.int64)
    position = np.column_stack([horizontal, np.zeros(len(horizontal)), vertical])
    return Errors(
        stamps, stamps, position, np.ones_like(position), None, None,
        protection_m=np.tile([4.0, 8.0], (len(horizontal), 1)),
    )  # fmt: skip


def drive(**changes: object) -> DriveObservations:
    given = DriveObservations(
        first_ns=START_NS,
        last_ns=START_NS + 100 * NS,
        track=track([second / 10 for second in range(1000)]),
        verdicts=verdicts((0, TrustLevel.SAFE)),
        fixes=[fix(START_NS + second * NS, None) for second in range(100)],
        satellites=[satellites(START_NS)],
        power=[],
        errors=None,
        gnss_alone=None,
        alert_limits_m=(10.0, 20.0),
    )
    return replace(given, **changes)  # type: ignore[arg-type]


def test_a_drive_without_fault_is_wholly_available_and_continuous() -> None:
    found = indicators_of(drive())
    assert list(found) == [row.name for row in INDICATORS]
    for name in ("solution_available_share", "usable_share", "fix_available_share", "continuity_15s_share",
                 "level_within_limit_share"):  # fmt: skip
        assert found[name] == 1.0, name
    assert found["interruptions"] == 0 and found["between_interruptions_s"] is None
    assert found["without_solution_s"] == found["time_to_first_fix_s"] == found["time_to_first_usable_s"] == 0.0
    assert found["duration_s"] == 100.0
    assert found["truth_count"] is None and found["horizontal_within_level_share"] is None
    assert (found["hdop_median"], found["satellites_used_min"], found["cn0_median_db_hz"]) == (0.9, 8.0, 40.0)


def test_a_gap_counts_from_two_seconds_behind_the_last_solution() -> None:
    """From 40 to 60 s: available until 42 s (20 s less 2)."""
    found = indicators_of(drive(track=track([s / 10 for s in range(1000) if not 400 < s < 600])))
    assert found["without_solution_s"] == found["longest_without_solution_s"] == pytest.approx(18.0, abs=0.2)
    assert found["solution_available_share"] == pytest.approx(0.82, abs=0.002)
    assert found["interruptions"] == 1
    assert found["longest_interruption_s"] == pytest.approx(18.0, abs=0.2)
    assert found["between_interruptions_s"] == pytest.approx(82.0, abs=0.2)
    # Usable times that are followed by 15 s: to 42 s, and from 60 to 85 s. Those of the last 15 s before 42 s fail.
    assert found["continuity_15s_share"] == pytest.approx(1.0 - 15.0 / (42.0 + 25.0), abs=0.005)


def test_unsafe_is_available_but_not_usable() -> None:
    levels = (0, TrustLevel.INITIALISING), (10, TrustLevel.SAFE), (50, TrustLevel.UNSAFE), (60, TrustLevel.CAUTION)
    found = indicators_of(drive(verdicts=verdicts(*levels)))
    assert found["solution_available_share"] == 1.0
    assert found["usable_share"] == pytest.approx(0.8, abs=0.002)
    assert found["time_to_first_usable_s"] == pytest.approx(10.0, abs=0.11)
    assert (found["interruptions"], found["unsafe_s"]) == (1, 10.0)
    assert found["longest_interruption_s"] == pytest.approx(10.0, abs=0.2)


def test_integrity_counts_seconds_above_level_and_limit() -> None:
    horizontal = [1.0] * 90 + [5.0] * 6 + [11.0] * 4
    vertical = [1.0] * 99 + [-9.0]
    levels = (0, TrustLevel.SAFE), (95, TrustLevel.UNSAFE)
    found = indicators_of(drive(errors=errors(horizontal, vertical), verdicts=verdicts(*levels)))
    assert found["horizontal_within_level_share"] == 0.9
    assert found["horizontal_misleading_s"] == pytest.approx(10.0)
    assert found["horizontal_misleading_while_usable_s"] == pytest.approx(5.0)
    assert found["horizontal_hazardous_s"] == pytest.approx(4.0)
    assert found["vertical_misleading_s"] == pytest.approx(1.0)
    assert found["vertical_hazardous_s"] == 0.0
    assert found["horizontal_level_median_m"] == 4.0


def test_accuracy_by_axis_of_solution_and_receiver() -> None:
    stamps = START_NS + NS * np.arange(4, dtype=np.int64)
    alone = GnssAlone(stamps, np.tile([3.0, 0.0, 4.0], (4, 1)), np.tile([0.6, 0.0, 0.8], (4, 1)))
    found = indicators_of(drive(errors=errors([3.0, 3.0, 3.0, 5.0], [4.0] * 4), gnss_alone=alone))
    assert found["fused_north_rmse_m"] == pytest.approx(np.sqrt(13.0), rel=1e-5)
    assert (found["fused_east_rmse_m"], found["fused_down_rmse_m"]) == (0.0, 4.0)
    assert found["fused_3d_rmse_m"] == pytest.approx(np.sqrt(29.0), rel=1e-5)
    assert (found["fused_horizontal_p50_m"], found["fused_horizontal_max_m"]) == (3.0, 5.0)
    assert found["gnss_3d_rmse_m"] == 5.0
    assert found["fused_over_gnss"] == pytest.approx(0.2)


def test_a_fix_without_height_has_no_error_in_space() -> None:
    alone = GnssAlone(np.array([START_NS]), np.array([[3.0, 0.0, np.nan]]), np.zeros((1, 3)))
    found = indicators_of(drive(gnss_alone=alone))
    assert (found["gnss_north_rmse_m"], found["gnss_3d_rmse_m"], found["fused_over_gnss"]) == (3.0, None, None)


def test_shares_of_rtk() -> None:
    kinds = [CarrierSolution.FIXED, *[CarrierSolution.FLOAT] * 3] * 25
    fixes = [fix(START_NS + s * NS, None, carrier_solution=kind) for s, kind in enumerate(kinds)]
    found = indicators_of(drive(fixes=fixes))
    assert (found["rtk_fixed_share"], found["rtk_float_share"]) == (0.25, 0.75)


def test_nothing_is_known_of_an_empty_drive_and_no_indicator_fails() -> None:
    empty = drive(track=track([]), verdicts=None, fixes=[], satellites=[])
    found = indicators_of(empty)
    known = {name: value for name, value in found.items() if value is not None}
    assert known == {"solution_available_share": 0.0, "fix_available_share": 0.0, "duration_s": 100.0}
    assert indicators_of(replace(empty, last_ns=START_NS))["duration_s"] == 0.0


def test_the_page_holds_every_indicator_and_escapes_what_a_recording_says() -> None:
    text = page("<b>", "x & y", "anew", indicators_of(drive()))
    assert all(f"<code>{row.name}</code>" in text for row in INDICATORS)
    assert "<b>" not in text and "&lt;b&gt;" in text and "x &amp; y" in text
    assert "http" not in text


def test_the_rows_of_the_papers_table_are_those_of_the_fixes() -> None:
    """Mean and sigma of the axes, geometric and time dilution, the receiver's own levels, accuracy of its time."""
    error = np.array([[1.0, 2.0, 3.0], [3.0, 2.0, 1.0]])
    found = _errors("gnss", error)
    assert (found["gnss_north_mean_m"], found["gnss_north_sigma_m"]) == (2.0, 1.0)
    assert (found["gnss_east_mean_m"], found["gnss_east_sigma_m"]) == (2.0, 0.0)
    stated = {"gdop": 2.0, "tdop": 0.8, "time_sd_s": 4e-9}
    levels = [(4.0, 5.0, 6.0), (6.0, 5.0, 8.0)]
    fixes = [
        fix(START_NS + k * NS, None).model_copy(update={**stated, "stated_level_ned_m": levels[k % 2]})
        for k in range(10)
    ]
    found = indicators_of(drive(fixes=fixes))
    assert (found["gdop_median"], found["tdop_median"], found["time_accuracy_mean_s"]) == (2.0, 0.8, 4e-9)
    assert (found["receiver_level_north_mean_m"], found["receiver_level_north_sigma_m"]) == (5.0, 1.0)
    assert (found["receiver_level_down_mean_m"], found["receiver_level_east_sigma_m"]) == (7.0, 0.0)
    assert found["satellites_received_mean"] == len(satellites(START_NS).satellites)
    assert indicators_of(drive())["receiver_level_north_mean_m"] is None, "most receivers state none"


def test_consumption_and_autonomy_are_those_of_the_time_on_the_battery() -> None:
    """7.4 V and 0.5 A for half an hour of two are 3.7 W; a quarter of the charge in it lasts 2 h when full."""
    power = [
        PowerState(
            sampled_ns=START_NS + k * 10 * NS, source="ups0", on_battery=k <= 180, voltage_v=7.4,
            current_a=-0.5 if k <= 180 else 0.2, charge_ratio=max(0.75, 1.0 - 0.25 * k / 180), reason="",
        )
        for k in range(720)
    ]  # fmt: skip
    found = indicators_of(drive(power=power))
    assert found["on_battery_s"] == 1800.0
    assert found["consumption_mean_w"] == pytest.approx(3.7)
    assert found["autonomy_h"] == pytest.approx(2.0)
    assert indicators_of(drive())["consumption_mean_w"] is None

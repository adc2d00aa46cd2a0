from pathlib import Path

import numpy as np
import pytest

from cli.solve.reference_track import from_columns, from_fixes, from_states
from cli.solve.truth import truth_file
from shared.errors import UserError
from shared.messages.gnss import CarrierSolution, FixType, GnssFix


def fix(second: int, carrier: CarrierSolution, height_m: float | None = 300.0) -> GnssFix:
    stamp = second * 1_000_000_000
    return GnssFix(
        sampled_ns=stamp, received_ns=stamp, source="gnss", fix_type=FixType.THREE_D, carrier_solution=carrier,
        latitude_deg=45.0, longitude_deg=9.0, height_ellipsoid_m=height_m, position_sd_ned_m=(0.01, 0.01, 0.02),
    )  # fmt: skip


def test_only_rtk_fixed_positions_are_truth() -> None:
    words = [CarrierSolution.FIXED, CarrierSolution.FLOAT, CarrierSolution.NONE, CarrierSolution.FIXED]
    found = from_fixes([fix(k, word) for k, word in enumerate(words)])
    assert found.stamps_ns.tolist() == [0, 3_000_000_000]
    assert found.at_antenna
    assert found.velocity_n is None, "one fix without velocity makes it unknown"
    assert found.geodetic is not None
    np.testing.assert_allclose(found.geodetic[0], [np.radians(45.0), np.radians(9.0), 300.0])
    assert "not independent" in found.description


def test_the_error_without_rtk_fixes_lists_the_recorded_qualities() -> None:
    with pytest.raises(UserError, match="2 float"):
        from_fixes([fix(k, CarrierSolution.FLOAT) for k in range(2)])
    with pytest.raises(UserError, match="no fix at all"):
        from_fixes([])
    with pytest.raises(UserError, match="1 fixed"):
        from_fixes([fix(0, CarrierSolution.FIXED, height_m=None)])


def test_a_recording_without_true_states_is_rejected() -> None:
    with pytest.raises(UserError, match="--truth fixes"):
        from_states([])


def test_unknown_and_deselected_quantities_of_a_table_are_none() -> None:
    stamps = np.array([0, 1], dtype=np.int64)
    columns = {name: np.zeros(2) for name in ("latitude_deg", "longitude_deg", "height_ellipsoid_m", "yaw_rad")}
    found = from_columns("peer.csv", stamps, columns)
    assert found.geodetic is not None and found.velocity_n is None and found.attitude is None
    assert found.only(["velocity", "attitude"]).geodetic is None


def test_fixes_are_stamped_with_the_configured_delay() -> None:
    found = from_fixes([fix(5, CarrierSolution.FIXED)], delay_s=0.1, velocity_delay_s=0.125)
    assert found.stamps_ns.tolist() == [4_900_000_000] and found.velocity_delay_ns == 125_000_000


def test_a_truth_in_utc_is_brought_to_the_time_line_of_the_unit(tmp_path: Path) -> None:
    (tmp_path / "truth.csv").write_text("utc_s,latitude_deg,longitude_deg,height_ellipsoid_m\n1700000000.5,48,11,500\n")
    truth = truth_file(tmp_path / "truth.csv")
    assert truth.on_time_line(3_600_000_000_000).stamps_ns.tolist() == [1_699_996_400_500_000_000]
    assert truth.on_time_line(40_000_000) is truth, "the delay of a receiver, and no clock"
    (tmp_path / "line.csv").write_text("sampled_ns,latitude_deg,longitude_deg,height_ellipsoid_m\n5,48,11,500\n")
    assert truth_file(tmp_path / "line.csv").on_time_line(3_600_000_000_000).stamps_ns.tolist() == [5]

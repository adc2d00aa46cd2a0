"""Real single-point receivers: fused positions are not worse than the fixes, and no error is above its level."""

import json
from pathlib import Path

import pytest

from cli.import_drive.import_drive import import_drive
from cli.solve.solve import solve
from tests.support.data import REPOSITORY, recording

MAPPINGS = REPOSITORY / "benchmarks" / "recordings" / "mappings"
pytestmark = [pytest.mark.recording, pytest.mark.slow]


def solved(name: str, out: Path) -> dict[str, float]:
    import_drive(MAPPINGS / f"{name}.toml", recording(name), out / "drive.mcap")
    assert solve(out / "drive.mcap", out=out / "solution") == 0
    found: dict[str, float] = json.loads((out / "solution" / "metrics.json").read_text())
    return found


@pytest.mark.parametrize(
    ("name", "most_m"),
    [("comma_segment", 0.44), ("navmatlab_car", 0.65), ("navmatlab_car_0327", 1.05)],
)
def test_fusion_of_a_single_point_receiver_is_not_worse_than_the_receiver(
    name: str, most_m: float, tmp_path: Path
) -> None:
    """Measured: 0.44, 0.69 and 1.17 m for the receivers, 0.43, 0.57 and 0.87 m fused."""
    found = solved(name, tmp_path)
    assert found["horizontal_rmse_m"] <= most_m
    assert found["protection_horizontal_misleading_fraction"] <= 0.001
    assert found["protection_vertical_misleading_fraction"] <= 0.001

"""An aid with a state of its own, from a package beside the unit: no file of core.fusion knows of it."""

import json
import os
import subprocess
import sys
from collections.abc import Sequence

import pytest

from services.core.fusion.blocks import MOST_STATES, Block, Layout
from services.core.fusion.settings import Settings
from services.core.fusion.start.warm_start import fingerprint
from services.core.fusion.states import AIDS, INERTIAL, LAYOUT, LEFT_OUT_WHEN_OFF
from tests.support.data import REPOSITORY
from tests.support.patience import HANGS_S

PACKAGE = REPOSITORY / "tests" / "support" / "radar"


def driven(scale: float, *, installed: bool = True) -> dict[str, float | str]:
    """Drive in a process of its own, where the package is on the path or not."""
    return printed("tests.support.radar_drive", str(scale), path=[str(PACKAGE)] if installed else [])


def printed(*module: str, path: Sequence[str] = ()) -> dict[str, float | str]:
    """What a program prints as JSON, with these folders on the path."""
    environment = os.environ | {"PYTHONPATH": os.pathsep.join([str(REPOSITORY), *path]), "NUMBA_DISABLE_JIT": "1"}
    done = subprocess.run(
        [sys.executable, "-m", *module], cwd=REPOSITORY, env=environment,
        capture_output=True, text=True, timeout=HANGS_S, check=True,
    )  # fmt: skip
    found: dict[str, float | str] = json.loads(done.stdout)
    return found


def test_the_scale_of_a_radar_is_estimated_as_a_state_of_its_own() -> None:
    found, without = driven(0.03), driven(0.03, installed=False)
    assert found["size"] == LAYOUT.size + 1 and without["size"] == LAYOUT.size
    sd = float(found["sd"])
    assert 0.0 < sd < 0.02, "it was 0.05 at the start"
    assert abs(float(found["scale"]) - 0.03) < 3.0 * sd
    assert found["fingerprint"] != without["fingerprint"], "a state saved with it is not one without it"
    assert found["solutions"] == without["solutions"]


def test_an_aid_that_is_off_equals_bit_for_bit_a_unit_without_its_states() -> None:
    off, without = (
        printed("tests.support.drives.without_carrier"),
        printed("tests.support.drives.without_carrier", "without"),
    )
    assert (off.pop("layout"), without.pop("layout")) == (LAYOUT.size, LAYOUT.size_by(Settings()))
    assert off == without and float(off["solutions"]) > 100


def test_the_layout_of_the_unit_is_the_one_of_old_states() -> None:
    assert LAYOUT.size == 37 and LAYOUT.blocks == (*INERTIAL, *AIDS, *LEFT_OUT_WHEN_OFF)
    assert LAYOUT.size_by(Settings()) == 31 and LAYOUT.blocks_by(Settings()) == (*INERTIAL, *AIDS)
    assert (LAYOUT.index("odometer_scale"), LAYOUT.place("gnss_error")) == (21, slice(24, 27))
    assert len(fingerprint(Settings())) == 16


def test_names_are_unique_and_the_number_of_states_is_bounded() -> None:
    with pytest.raises(ValueError, match="two aids"):
        Layout((*INERTIAL, Block("velocity", 1, "m")))
    with pytest.raises(ValueError, match="at most"):
        Layout((*INERTIAL, Block("large", MOST_STATES, "m")))
    with pytest.raises(ValueError, match="has 3 states"):
        LAYOUT.index("velocity")

"""A power cut or a killed process inside an attack: what was open before it is open after it."""

import pytest

from services.sensors.simulator.world import DEFAULT_START_NS
from shared.messages.trust import TrustLevel
from tests.support.drives.cuts import NS, Cut, cut_drive

pytestmark = pytest.mark.slow

USABLE = (TrustLevel.SAFE, TrustLevel.CAUTION)
ATTACK = "position_jump(distance=60)@60:60"
BEGIN_S, END_S, DRIVE_S = 68.0, 80.0, 110.0


@pytest.mark.parametrize(
    "processes",
    [
        pytest.param((), id="unit"),
        pytest.param(("core.trust",), id="trust"),
        pytest.param(("core.fusion",), id="fusion"),
        pytest.param(("core.trust", "core.fusion"), id="both"),
    ],
)
def test_a_position_that_stepped_by_60_m_is_not_used_after_a_cut(processes: tuple[str, ...]) -> None:
    """The receiver goes on with the false position, at which a unit without memory would start and find it SAFE."""
    drive = cut_drive("urban", 1, DRIVE_S, ATTACK, Cut(BEGIN_S, END_S, processes))
    before = [state for state in drive.states if (state.sampled_ns - DEFAULT_START_NS) / NS < BEGIN_S]
    assert before[-1].state is TrustLevel.UNSAFE
    assert drive.above_level_s(list(TrustLevel), END_S + 2.0, DRIVE_S) == 0.0
    after = [state for state in drive.states if (state.sampled_ns - DEFAULT_START_NS) / NS >= END_S + 1.0]
    assert after and not any(trust_state.state in USABLE for trust_state in after)
    assert after[0].suspect_since_ns is not None and after[-1].state is TrustLevel.UNSAFE


def test_a_healthy_unit_after_a_cut_in_motion_is_not_safe_at_once_and_says_why() -> None:
    drive = cut_drive("urban", 1, 90.0, None, Cut(33.0, 38.0))
    after = [state for state in drive.states if (state.sampled_ns - DEFAULT_START_NS) / NS >= 75.0]
    assert {trust_state.state for trust_state in after} == {TrustLevel.CAUTION}
    assert after[-1].reason_codes[0].code == "trust.start_after_cut"
    assert drive.above_level_s(list(TrustLevel), 38.0, 90.0) == 0.0

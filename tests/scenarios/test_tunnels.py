"""After a loss of GNSS: a tunnel is no interference, and the return after interference is confirmed by the way."""

import pytest

from services.core.trust.after_loss import AGREEMENT_S
from shared.messages.trust import TrustLevel
from tests.support.drives.cuts import cut_drive

pytestmark = pytest.mark.slow

BEGIN_S, WITHIN_S = 60.0, 60.0


@pytest.mark.parametrize("length_s", [20.0, 60.0])
def test_a_tunnel_costs_at_most_a_minute_of_safe_after_it(length_s: float) -> None:
    end_s = BEGIN_S + length_s
    drive = cut_drive("urban", 1, end_s + WITHIN_S + 5.0, f"tunnel@{BEGIN_S:g}:{length_s:g}", None)
    assert drive.states[-1].state is TrustLevel.SAFE
    assert all(state.gnss_disturbed_since_ns is None for state in drive.states)
    assert drive.above_level_s(list(TrustLevel), BEGIN_S, end_s + WITHIN_S + 5.0) == 0.0


def test_a_return_after_jamming_is_confirmed_by_the_way_that_agrees() -> None:
    drive = cut_drive("urban", 1, 190.0, "jam(power=60,rise=60)@60:12", None)
    since = [state.gnss_disturbed_since_ns for state in drive.states if state.gnss_disturbed_since_ns is not None]
    assert len(set(since)) == 1
    assert drive.seconds(TrustLevel.SAFE, 66.0, 72.0 + AGREEMENT_S[0]) == 0.0
    assert drive.states[-1].state is TrustLevel.SAFE
    assert drive.above_level_s(list(TrustLevel), 60.0, 190.0) == 0.0

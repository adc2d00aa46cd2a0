"""Loss, repetition, reordering and kills at a toll plaza: the short form of `python -m benchmarks.toll_campaign`."""

from pathlib import Path

import pytest

from benchmarks.toll_campaign import campaign

pytestmark = pytest.mark.slow


def test_kills_of_core_toll_and_ledger_charge_nobody_twice_and_every_detection_has_one_outcome(tmp_path: Path) -> None:
    result = campaign(passages=60, kills=6, seed=2, vehicles=60, folder=tmp_path)
    assert result.kills_core + result.kills_ledger >= 4
    assert result.double_charges == result.wrong_charges == 0
    assert result.reconciliation_exact
    assert result.decided > 0.6 * result.registered
    assert result.charged_share_of_decided >= 0.99
    assert result.outbox == 0

"""monitoring.uplink and a whole centre, as `obu centre up` runs it."""

import time
from pathlib import Path
from typing import cast

import pytest

from shared.evidence import KeyFile
from shared.fleet.enrolling import enrol
from shared.fleet.sealed import unsealed
from tests.support.fleet.uplink_unit import NS, START_NS, UplinkUnit
from tests.support.fleet.vehicle_link import rows, token_for


@pytest.mark.slow
def test_a_unit_enrols_reports_an_hour_and_goes_on_with_another_key(folder: Path, tmp_path: Path) -> None:
    keys = KeyFile(tmp_path / "keys")
    enrol(*token_for(folder, "uplink-1"), "uplink-1", tmp_path / "uplink", keys.signer())
    unit = UplinkUnit(tmp_path, enrolled=True)
    unit.offset_ns = time.time_ns() - START_NS - 3600 * 1_000_000_000
    unit.drive(1800)
    unit.work_until(lambda: unit.state_message().connected and unit.state_message().backlog_batches == 0)

    keys.rotate(time.time_ns())
    unit.drive(1700)
    # A refusal that was on its way while the key was registered holds for an hour.
    unit.work_until(lambda: unit.state_message().backlog_batches == 0, step_s=5.0)

    assert unit.process._enrolment.renewals == 1
    where = "WHERE vehicle = 'uplink-1'"
    made = rows(folder, f"SELECT sum(count), max(first_sequence + count) FROM segment {where}")
    assert made[0][0] == made[0][1] and int(str(made[0][0])) >= 3490
    assert rows(folder, f"SELECT count(*) FROM set_aside {where}") == [(0,)]
    assert rows(folder, f"SELECT count(*) FROM certificate {where} AND kind = 'evidence'") == [(2,)]
    unit.close()


@pytest.mark.parametrize("wrong_days", [2, 3650, -1, -500])
def test_what_a_unit_reports_with_a_wrong_clock_is_kept_once_and_what_follows_is_shown(
    folder: Path, tmp_path: Path, wrong_days: int
) -> None:
    name = f"clock{wrong_days}"
    unit_keys = KeyFile(tmp_path / "keys")
    enrol(*token_for(folder, name), name, tmp_path / "uplink", unit_keys.signer())
    unit = UplinkUnit(tmp_path, enrolled=True)
    right_ns = time.time_ns() - START_NS - 300 * NS
    for offset_ns in (right_ns, right_ns + wrong_days * 86_400 * NS, right_ns):
        unit.offset_ns = offset_ns
        unit.drive(60)
        unit.work_until(lambda: unit.state_message().connected and unit.state_message().backlog_batches == 0)
    unit.work_until(lambda: unit.state_message().backlog_batches == 0, step_s=1.0)

    query = "SELECT content FROM {} WHERE vehicle = '" + name + "'"
    kept = [rows(folder, query.format(table)) for table in ("segment", "set_aside")]
    batches = [unsealed(cast(bytes, row[0])).batch for item in kept for row in item]
    numbers = sorted(number for batch in batches for number in range(batch.first, batch.first + batch.count))
    assert numbers == list(range(len(numbers))) and len(numbers) >= 170
    jumps = [event.name for batch in batches for event in batch.events]
    assert jumps == ["uplink/clock"] * 2
    assert bool(kept[1]) == (wrong_days != -1)
    last_ms = max((batch for batch in batches if batch.reports), key=lambda batch: batch.first).reports[-1].utc_ms
    assert rows(folder, f"SELECT utc_ms FROM vehicle_now WHERE vehicle = '{name}'") == [(last_ms,)]
    unit.close()

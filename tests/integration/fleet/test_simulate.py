"""Simulated vehicles and a whole centre whose parts are killed: each report is stored once."""

import csv
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import psycopg
import pytest

from cli.fleet.simulate import lines
from fleet.centre import Centre
from fleet.simulate import truth
from fleet.simulate.campaign import UNIT, Campaign, Plan
from fleet.simulate.outboxes import BatchTruth
from fleet.simulate.processes import INGEST, NATS, PARTS, POSTGRES, pids_of
from fleet.simulate.traffic import Disturbance
from shared.errors import UserError
from tests.support.fleet.running_centre import running_centre


@pytest.fixture(scope="module")
def centre() -> Iterator[Centre]:
    with running_centre() as folder:
        yield Centre(folder)


@pytest.mark.slow
def test_every_part_and_the_units_are_killed_and_each_report_is_stored_once(centre: Centre, tmp_path: Path) -> None:
    plan = Plan(
        30, 12.0, 8, unit_processes=2, backlog_s=60, kills=6, disturbance=Disturbance(0.2, reorder=True), retry_s=1.0,
        drain_s=90.0,
    )  # fmt: skip
    outcome = Campaign(centre, plan, print).run(tmp_path / "truth.csv")
    said = "\n".join(lines(outcome))
    assert outcome.verdict.holds and outcome.waiting == 0, said
    assert outcome.verdict.made == outcome.verdict.stored >= 30 * 60, said
    assert outcome.kills == Counter({INGEST: 2, POSTGRES: 2, UNIT: 1, NATS: 1})
    with (tmp_path / "truth.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert sum(int(row["reports"]) for row in rows) >= 22 * 60


def test_a_row_that_is_gone_a_foreign_and_an_overlapping_one_are_found(centre: Centre) -> None:
    campaign = Campaign(centre, Plan(3, 1.0, backlog_s=10, retry_s=1.0), print)
    outcome = campaign.run()
    assert outcome.verdict.holds
    made = campaign.made
    vehicles = sorted({item.vehicle for item in made})
    gone = sum(item.reports for item in made if item.vehicle == vehicles[0])
    with psycopg.connect(centre.owner_dsn) as db:
        db.execute("DELETE FROM segment WHERE vehicle = %s", vehicles[:1])
        db.execute(
            "INSERT INTO segment (day, vehicle, epoch, first_sequence, count, kind, from_ms, to_ms, tenant_id, digest, "
            "content) SELECT day, vehicle, epoch, 5, 10, kind, from_ms, to_ms, tenant_id, %s, content FROM segment "
            "WHERE vehicle = %s",
            (bytes(32), vehicles[2]),
        )
    found = truth.compared(centre.owner_dsn, vehicles, made)
    assert (found.lost, found.double, found.foreign) == (gone, 5, 10) and gone >= 10
    assert found.faults, "the counters of the centre no longer agree"


def test_the_chain_of_an_outbox_tells_what_is_missing(centre: Centre) -> None:
    none = truth.chained(centre.owner_dsn, "never-entered", {1000, 2000}, {1000, 2000, 3000})
    assert (none.made, none.stored, none.lost, none.double, none.foreign) == (2, 0, 2, 0, 0)


def test_each_part_of_a_centre_is_found(centre: Centre) -> None:
    assert all(len(pids_of(centre.folder, part)) == 1 for part in PARTS)
    assert not any(pids_of(centre.folder.parent, part) for part in PARTS)


def test_a_centre_that_does_not_run_is_named(tmp_path: Path) -> None:
    with pytest.raises(UserError, match="obu centre up"):
        Campaign(Centre(tmp_path / "centre"), Plan(1), print).run()


def test_the_truth_list_is_not_written_into_a_folder_that_is_not_there(tmp_path: Path) -> None:
    with pytest.raises(UserError, match="--out"):
        truth.write(tmp_path / "none" / "truth.csv", [BatchTruth("a", 1, 0, 10, bytes(32))])

"""monitoring.uplink as `obu run` starts it, on a real bus and a real broker of a centre."""

from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.support.fleet.certificates import Authority
from tests.support.fleet.small_centre import Broker, Memory, SmallCentre
from tests.support.fleet.uplink_process import UplinkProcess


@pytest.fixture
def authority() -> Authority:
    return Authority()


@pytest.fixture
def outer(tmp_path: Path, authority: Authority) -> Iterator[Broker]:
    made = Broker(tmp_path / "centre", authority)
    yield made
    made.stop()


@pytest.fixture
def unit(tmp_path: Path, outer: Broker, authority: Authority) -> Iterator[UplinkProcess]:
    made = UplinkProcess(tmp_path, outer.port, authority)
    yield made
    made.close()
    assert made.ended_with == 0


@pytest.mark.slow
def test_a_unit_reports_is_watched_and_loses_nothing_when_it_is_killed(outer: Broker, unit: UplinkProcess) -> None:
    memory = Memory("car", unit.key.public_key)
    centre = SmallCentre(outer, memory)
    unit.drive_until(lambda: bool(unit.states) and unit.states[-1].connected and unit.states[-1].receipted > 0)

    centre.watch(["imu/sample", "navigation/solution", "trust/state"], for_s=30.0)
    unit.drive_until(
        lambda: {topic for topic, _ in centre.live} >= {"imu/sample", "navigation/solution", "trust/state"}
    )
    unit.drive_until(lambda: unit.states[-1].watchers == 1)
    centre.watch([], 0.0, 0)
    unit.drive_until(lambda: unit.states[-1].watchers == 0)
    ended = centre.batches_seen
    unit.drive_until(lambda: centre.batches_seen >= ended + 2)  # what was on the way of the watch has come before
    seen = len(centre.live)

    for _ in range(3):
        unit.kill()
        states = len(unit.states)
        unit.drive_until(lambda: any(state.receipted > 0 for state in unit.states[states:]))  # noqa: B023
    assert len(centre.live) == seen, "nothing is passed on when nobody watches"
    unit.drive_until(lambda: unit.states[-1].backlog_batches == 0)

    times = [report.utc_ms for report in memory.reports()]
    assert all(report.verdict == 0 for report in memory.reports()), "a start is no loss of the position"
    assert times == sorted(set(times)) and len(times) >= 5
    assert len({batch.epoch_ms for batch in memory.chain()}) == 1
    centre.close()

import threading

import pytest
from prometheus_client.parser import text_string_to_metric_families

from services.monitoring.status.views import prometheus
from shared.messages.navigation import AidingKind
from shared.messages.operation import RecordingState
from shared.messages.trust import Belief, Hypothesis, TrustLevel
from tests.support.dashboard.status_world import START_NS, World, aiding, fix, solution, trust


def scrape(world: World) -> dict[str, dict[tuple[str, ...], float]]:
    collector = prometheus.StateCollector(world.state, lambda: world.now_ns, threading.Lock(), "0.1.0")
    text = prometheus.text(prometheus.registry_of(collector)).decode()
    found: dict[str, dict[tuple[str, ...], float]] = {}
    for family in text_string_to_metric_families(text):
        for sample in family.samples:
            found.setdefault(sample.name, {})[tuple(sample.labels.values())] = sample.value
    return found


@pytest.fixture
def world() -> World:
    world = World()
    world.beat("parsers.gnss", rejects={"checksum": 3})
    world.hear(fix(world.now_ns), "parsers.gnss")
    world.hear(solution(world.now_ns), "core.fusion")
    world.hear(aiding(AidingKind.GNSS_POSITION, 0.4), "core.fusion")
    world.hear(aiding(AidingKind.GNSS_VELOCITY, 2.5, used=False), "core.fusion")
    recording = RecordingState(
        now_ns=START_NS, recording=True, file="x", bytes_written=12_000, messages=3, dropped=0, free_bytes=41_000
    )
    world.hear(recording, "monitoring.recorder")
    world.hear(trust(world.now_ns, TrustLevel.CAUTION), "core.trust")
    world.pass_time(0.5)
    return world


def test_names_follow_the_conventions_of_prometheus(world: World) -> None:
    found = scrape(world)
    assert found["obu_gnss_fix_mode"] == {(): 3.0}
    assert found["obu_gnss_satellites_used"] == {(): 14.0}
    assert found["obu_clock_offset_seconds"][()] == pytest.approx(0.25)
    assert found["obu_integrity_state"][("caution",)] == 1.0
    assert found["obu_integrity_state"][("safe",)] == 0.0
    assert found["obu_monitor_statistic"] == {
        ("innovation_gnss_position",): 0.4, ("innovation_gnss_velocity",): 2.5, ("inertial_short",): 0.5,
    }  # fmt: skip
    assert found["obu_monitor_outcome"] == {
        ("inertial_short", "pass"): 1.0, ("inertial_short", "accuses"): 0.0, ("inertial_short", "not_evaluated"): 0.0,
    }  # fmt: skip
    assert found["obu_monitor_alarms_total"][("innovation_gnss_velocity",)] == 1.0
    assert found["obu_topic_age_seconds"][("gnss/fix",)] == pytest.approx(0.5)
    assert found["obu_process_restarts_total"][("parsers.gnss",)] == 0.0
    assert found["obu_process_up"][("parsers.gnss",)] == 1.0
    assert found["obu_parser_rejects_total"] == {("parsers.gnss", "checksum"): 3.0}
    assert found["obu_recorder_bytes_total"] == {(): 12_000.0}
    assert found["obu_disk_free_bytes"] == {(): 41_000.0}
    assert found["obu_build_info"] == {("0.1.0",): 1.0}


def test_no_protection_level_is_claimed_while_none_is_computed(world: World) -> None:
    assert not any("hpl" in name or "vpl" in name or "risk" in name for name in scrape(world))


def test_protection_levels_are_there_with_their_risk_until_they_are_stale(world: World) -> None:
    levels = {"protection_level_horizontal_m": 3.1, "protection_level_vertical_m": 4.2, "integrity_risk": 1e-3}
    world.hear(solution(world.now_ns, **levels), "core.fusion")
    found = scrape(world)
    assert found["obu_position_hpl_meters"] == {(): 3.1}
    assert found["obu_position_vpl_meters"] == {(): 4.2}
    assert found["obu_position_integrity_risk"] == {(): 1e-3}
    world.pass_time(20.0)
    assert "obu_position_hpl_meters" not in scrape(world)


def test_a_stale_value_is_left_out_and_not_repeated(world: World) -> None:
    world.pass_time(20.0)
    found = scrape(world)
    assert not {"obu_gnss_fix_mode", "obu_gnss_satellites_used", "obu_disk_free_bytes"} & found.keys()
    assert found["obu_topic_age_seconds"][("gnss/fix",)] == pytest.approx(20.5)
    assert found["obu_integrity_state"][("stale",)] == 1.0


def test_each_hypothesis_has_its_probability_while_the_verdict_is_live(world: World) -> None:
    beliefs = tuple(
        Belief(hypothesis=hypothesis, prior=1e-4, probability=probability, survives=probability > 1e-3, reason="x")
        for hypothesis, probability in ((Hypothesis.GNSS, 0.25), (Hypothesis.ODOMETER, 1e-5))
    )
    world.hear(trust(world.now_ns, TrustLevel.CAUTION, beliefs=beliefs), "core.trust")
    found = scrape(world)
    assert found["obu_hypothesis_probability"] == {("gnss",): 0.25, ("odometer",): 1e-5}
    assert found["obu_hypothesis_survives"] == {("gnss",): 1.0, ("odometer",): 0.0}
    world.pass_time(6.0)
    assert "obu_hypothesis_probability" not in scrape(world)

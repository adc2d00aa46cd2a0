"""monitoring.uplink and a centre over a real broker with TLS, and over networks that are worse than any real one."""

import socket
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from shared.fleet.batch import Batch, Kind
from shared.fleet.receipts import Receipt, StoredBatch
from shared.messages.trust import TrustEvent, TrustLevel
from tests.support.fleet.bad_network import BadNetwork
from tests.support.fleet.certificates import Authority
from tests.support.fleet.small_centre import Broker, Courier, Memory, SmallCentre
from tests.support.fleet.uplink_unit import UplinkUnit
from tests.support.patience import HANGS_S


@pytest.fixture(scope="module")
def authority() -> Authority:
    return Authority()


@pytest.fixture(params=["nats", "mosquitto"])
def broker(request: pytest.FixtureRequest, tmp_path: Path, authority: Authority) -> Iterator[Broker]:
    made = Broker(tmp_path / "broker", authority, request.param)
    yield made
    made.stop()


@pytest.fixture
def nats(tmp_path: Path, authority: Authority) -> Iterator[Broker]:
    made = Broker(tmp_path / "broker", authority)
    yield made
    made.stop()


def unit_at(port: int, tmp_path: Path, authority: Authority) -> UplinkUnit:
    return UplinkUnit(tmp_path / "state", port, authority=authority)


def memory_of(unit: UplinkUnit) -> Memory:
    return Memory("car", unit.signer.public_key)


def is_drained(unit: UplinkUnit) -> bool:
    return bool(unit.bus.published) and unit.state_message().backlog_batches == 0


def test_reports_reach_a_real_broker_over_tls_and_receipts_empty_the_outbox(
    broker: Broker, tmp_path: Path, authority: Authority
) -> None:
    unit = unit_at(broker.port, tmp_path, authority)
    centre = SmallCentre(broker, memory_of(unit))

    unit.drive(60)
    unit.work_until(lambda: unit.state_message().connected and is_drained(unit))

    reports = centre.memory.reports()
    times = [report.utc_ms for report in reports]
    assert len(reports) >= 50 and times == sorted(set(times))
    assert all(report.latitude_e7 is not None and report.level_dm == 33 and report.verdict == 0 for report in reports)
    unit.close()
    centre.close()


@pytest.mark.slow
def test_a_day_without_a_centre_arrives_once_and_in_one_chain(
    nats: Broker, tmp_path: Path, authority: Authority
) -> None:
    with BadNetwork(nats.port) as network:
        network.weather.is_away = True
        unit = unit_at(network.port, tmp_path, authority)
        centre = SmallCentre(nats, memory_of(unit))
        unit.drive(3 * 3600)
        unit.drive(300, speed_m_s=0.0)
        unit.drive(21 * 3600, speed_m_s=0.0, step_s=60)  # parked
        assert not centre.memory.batches and unit.state_message().backlog_batches > 1000

        network.weather.is_away = False
        unit.work_until(lambda: unit.state_message().connected and is_drained(unit))

        times = [report.utc_ms for report in centre.memory.reports()]
        assert len(times) >= 3 * 3600 + 300 + 21 * 60 - 11 and times == sorted(set(times))
        assert times[-1] - times[0] >= 86_400_000
        assert max(centre.memory.arrivals.values()) == 1
        unit.close()
        centre.close()


@pytest.mark.slow
def test_batches_and_receipts_that_are_lost_repeated_and_reordered_are_stored_once(
    nats: Broker, tmp_path: Path, authority: Authority
) -> None:
    unit = unit_at(nats.port, tmp_path, authority)
    up, down = Courier(0.2, 0.2, 0.2, seed=1), Courier(0.2, 0.2, 0.2, seed=2)
    centre = SmallCentre(nats, memory_of(unit), up, down)

    unit.drive(600)
    # Ten seconds of the unit in each turn: what got no receipt is sent again.
    unit.work_until(lambda: unit.state_message().connected and is_drained(unit), step_s=0.5)

    times = [report.utc_ms for report in centre.memory.reports()]
    assert times == sorted(set(times)) and len(times) >= 589
    assert all(up.counts[what] and down.counts[what] for what in ("lost", "repeated", "held"))
    unit.close()
    centre.close()


@pytest.mark.slow
def test_a_network_that_resets_within_packets_and_a_broker_that_is_killed_cost_nothing(
    nats: Broker, tmp_path: Path, authority: Authority
) -> None:
    with BadNetwork(nats.port) as network:
        network.weather.reset_after_bytes = 9_000
        unit = unit_at(network.port, tmp_path, authority)
        centre = SmallCentre(nats, memory_of(unit))
        unit.drive(900)
        unit.work_until(lambda: network.resets >= 3)
        nats.stop()
        nats.start()
        network.weather.reset_after_bytes = None
        network.weather.delay_s = 0.01
        network.cut()
        unit.work_until(lambda: is_drained(unit), step_s=0.1)

        times = [report.utc_ms for report in centre.memory.reports()]
        assert times == sorted(set(times)) and len(times) >= 889
        unit.close()
        centre.close()


def test_a_centre_without_its_database_is_sent_the_same_again_when_it_is_back(
    nats: Broker, tmp_path: Path, authority: Authority
) -> None:
    unit = unit_at(nats.port, tmp_path, authority)
    centre = SmallCentre(nats, memory_of(unit))
    centre.is_storing = False
    unit.drive(120)
    unit.work_until(lambda: unit.state_message().sent >= 4)
    before = unit.state_message().sent
    for _ in range(100):
        unit.turn(step_s=0.1)
    assert unit.state_message().receipted == 0
    assert unit.state_message().sent - before <= 4, "four are in flight, and tried again after ten seconds"

    centre.is_storing = True
    unit.work_until(lambda: is_drained(unit), step_s=1.0)
    assert len(centre.memory.reports()) >= 109
    unit.close()
    centre.close()


def test_events_and_changes_of_the_verdict_overtake_a_backlog(
    nats: Broker, tmp_path: Path, authority: Authority
) -> None:
    network = BadNetwork(nats.port)
    network.weather.is_away = True
    unit = unit_at(network.port, tmp_path, authority)
    unit.drive(600)
    event = TrustEvent(sampled_ns=unit.now_ns, before=TrustLevel.SAFE, after=TrustLevel.UNSAFE, reasons=("test",))
    unit.drive(1, TrustLevel.UNSAFE, also=(event,))
    arrived: list[Batch] = []
    memory = memory_of(unit)
    memory.refuse = arrived.append
    centre = SmallCentre(nats, memory)

    network.weather.is_away = False
    unit.work_until(lambda: is_drained(unit))

    assert arrived[0].kind is Kind.EVENTS and arrived[0].events[0].content["after"] == "unsafe"
    # The newest is that with the changed verdict, or one that was made while the unit connected.
    assert arrived[1].reports[-1].verdict != 0 and arrived[1].first == max(batch.first for batch in arrived[:6])
    assert arrived[2].first == 0
    assert [batch.first for batch in arrived[2:20]] == sorted(batch.first for batch in arrived[2:20])
    unit.close()
    centre.close()
    network.close()


def test_batches_of_a_key_that_the_centre_does_not_know_are_kept_marked_and_sent_when_it_knows_it(
    nats: Broker, tmp_path: Path, authority: Authority
) -> None:
    unit = unit_at(nats.port, tmp_path, authority)
    known, memory = memory_of(unit).keys, memory_of(unit)
    memory.keys = {}
    centre = SmallCentre(nats, memory)
    unit.drive(100)
    unit.work_until(lambda: unit.state_message().backlog_refused == unit.state_message().backlog_batches >= 9)
    assert not memory.batches and unit.bus.rejects["receipt of no batch"] == 0

    memory.keys = known
    unit.drive(1)
    unit.turn(step_s=3600.0)
    unit.work_until(lambda: is_drained(unit))
    assert len(memory.reports()) >= 90
    unit.close()
    centre.close()


def test_receipts_of_others_and_what_is_no_receipt_delete_nothing(
    nats: Broker, tmp_path: Path, authority: Authority
) -> None:
    unit = unit_at(nats.port, tmp_path, authority)
    centre = SmallCentre(nats, memory_of(unit))
    centre.is_storing = False
    unit.drive(40)
    unit.work_until(lambda: centre.batches_seen >= 4)  # the server took its subscription before
    waiting = unit.state_message().backlog_batches
    epoch = unit.process._reporting.sending.outbox.epoch_ms  # type: ignore[union-attr]

    for data in (b"", b"\xff" * 100, b"\xa0", Receipt(stored=(StoredBatch(epoch, 0, b"12345678"),)).encode(),
                 Receipt(stored=(StoredBatch(epoch + 1, 10, b"12345678"),)).encode()):  # fmt: skip
        centre.answer(data)
    unit.work_until(lambda: unit.bus.rejects["receipt"] >= 3 and unit.bus.rejects["receipt of no batch"] >= 2)

    assert unit.state_message().backlog_batches == waiting
    unit.close()
    centre.close()


def test_a_server_without_tls_or_of_another_authority_is_told_nothing(tmp_path: Path, authority: Authority) -> None:
    foreign = Broker(tmp_path / "broker", Authority("somebody else"), "mosquitto")
    unit = unit_at(foreign.port, tmp_path, authority)
    unit.drive(30)
    unit.work_until(lambda: "does not prove to be the centre" in (unit.state_message().offline or ""))
    unit.close()
    foreign.stop()

    with socket.create_server(("127.0.0.1", 0)) as plain:
        plain.settimeout(HANGS_S)
        other = UplinkUnit(tmp_path / "other", plain.getsockname()[1], authority=authority)
        other.drive(1)
        deadline = time.monotonic() + HANGS_S
        received = b""
        while not received and time.monotonic() < deadline:
            other.turn(step_s=0.1)
            client, _ = plain.accept()
            client.settimeout(HANGS_S)
            received = client.recv(4096)
            client.sendall(b"\x20\x02\x00\x00")  # CONNACK without TLS
            client.close()
        assert received[:2] == b"\x16\x03", "the first bytes are those of a TLS handshake"
        other.work_until(lambda: "no connection" in (other.state_message().offline or ""))
        assert not other.state_message().connected and other.state_message().sent == 0
        other.close()


def test_a_broker_refuses_a_unit_without_a_certificate_of_its_authority(
    nats: Broker, tmp_path: Path, authority: Authority
) -> None:
    unit = unit_at(nats.port, tmp_path, authority)
    stranger = Authority("somebody else")
    key, certificate = stranger.certified("car")
    tls = tmp_path / "state" / "uplink" / "tls.pem"
    tls.chmod(0o600)
    tls.write_text(key + certificate)
    unit.drive(3)
    unit.work_until(lambda: "no connection" in (unit.state_message().offline or ""))
    assert unit.state_message().sent == 0
    unit.close()

import hashlib
import tracemalloc
from collections import Counter, defaultdict
from collections.abc import Iterable
from dataclasses import replace
from itertools import islice, pairwise, takewhile
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

from services.sensors.simulator.gnss.simulated_receiver import SOURCE
from services.sensors.simulator.scenarios import BY_NAME, NAMES
from services.sensors.simulator.world import DEFAULT_START_NS, Equipment, World, messages
from shared.bus.codec import encode
from shared.messages.base import Message
from shared.messages.gnss import GnssRaw
from shared.messages.imu import ImuRaw
from shared.messages.navigation import TruthState
from shared.messages.neighbours import NeighbourStates
from shared.messages.operation import HostClock, Origin, OriginKind
from shared.messages.vehicle import CanRaw
from shared.protocols import xbus
from shared.topics import BY_MESSAGE, publications
from tests.support.cases import each
from tests.support.gnss.ublox import parse_ubx, valget, valset

NS = 1_000_000_000


def stamp(message: Message) -> int:
    match message:
        case ImuRaw() | GnssRaw() | CanRaw() | NeighbourStates():
            return message.received_ns
        case TruthState() | HostClock():
            return message.sampled_ns
        case Origin():
            return message.now_ns
    raise AssertionError(message)


def fingerprint(stream: Iterable[Message]) -> str:
    digest = hashlib.sha256()
    for message in stream:
        digest.update(repr((type(message).__name__, encode(message))).encode())
    return digest.hexdigest()


def frames(stream: Iterable[Message]) -> list[tuple[int, Any]]:
    """Give each UBX message of the receiver and when its last byte arrived."""
    found, rest = [], b""
    for message in stream:
        if isinstance(message, GnssRaw):
            rest += message.data
            while rest:
                if rest.startswith(b"$"):
                    if (end := rest.find(b"\n") + 1) == 0:
                        break
                    rest = rest[end:]
                    continue
                if len(rest) < 8 or len(rest) < (end := 8 + int.from_bytes(rest[4:6], "little")):
                    break
                found.append((message.received_ns, parse_ubx(rest[:end])))
                rest = rest[end:]
    return found


@pytest.fixture(scope="module")
def minute() -> list[Message]:
    return list(messages("parking_lot", 1, 60.0))


def test_messages_are_in_order_of_arrival_with_the_rates_of_their_devices(minute: list[Message]) -> None:
    assert all(stamp(a) <= stamp(b) for a, b in pairwise(minute))
    counts = Counter(type(message).__name__ for message in minute)
    assert counts["ImuRaw"] in range(5998, 6002)
    assert counts["TruthState"] in range(599, 602)
    assert counts["CanRaw"] == 600
    assert counts["Origin"] in range(30, 32)


def test_the_simulator_publishes_exactly_its_topics(minute: list[Message]) -> None:
    allowed = {topic.name for topic in publications("sensors.simulator")}
    assert {BY_MESSAGE[type(message)].name for message in minute} == allowed - {
        "health/+", "consumed/+", "simulation/roads", "simulation/state"
    }  # fmt: skip  # roads once at the start, the last with attacks only


@each("name", NAMES)
def test_equal_seeds_give_equal_bytes_and_different_seeds_differ(name: str) -> None:
    first, again, other = (fingerprint(messages(name, seed, 5.0)) for seed in (3, 3, 4))
    assert first == again
    assert first != other


def test_no_raw_message_holds_a_true_coordinate(minute: list[Message]) -> None:
    """Neither the receiver's position nor any text in the raw bytes equals the truth."""
    truth = [message for message in minute if isinstance(message, TruthState)]
    for number, parsed in frames(minute):
        if parsed.identity == "NAV-HPPOSLLH":
            nearest = min(truth, key=lambda t: abs(t.sampled_ns - number))
            assert parsed.lat != round(nearest.latitude_deg, 9)
    for message in minute:
        if isinstance(message, CanRaw | ImuRaw | GnssRaw):
            assert b"truth" not in message.data
            assert b"latitude" not in message.data


def test_truth_is_sampled_at_10_hz_with_a_constant_period(minute: list[Message]) -> None:
    stamps = np.array([message.sampled_ns for message in minute if isinstance(message, TruthState)])
    steps = set(np.diff(stamps).tolist())
    assert len(steps) == 1
    assert steps.pop() == pytest.approx(100_000_000, rel=21e-6)


def test_imu_messages_are_mtdata2_at_100_hz(minute: list[Message]) -> None:
    rejects: Counter[str] = Counter()
    reader = xbus.XbusReader(rejects)
    ticks, counters, arrivals = [], [], []
    for message in minute:
        if not isinstance(message, ImuRaw):
            continue
        (parsed,) = reader.feed(message.data)
        assert parsed.mid == xbus.MTDATA2
        values = xbus.decode_mtdata2(parsed.payload, rejects)
        assert set(values) == {
            xbus.TEMPERATURE, xbus.PACKET_COUNTER, xbus.SAMPLE_TIME_FINE, xbus.BARO_PRESSURE, xbus.ACCELERATION,
            xbus.RATE_OF_TURN, xbus.MAGNETIC_FIELD, xbus.STATUS_WORD,
        }  # fmt: skip
        ticks.append(int(values[xbus.SAMPLE_TIME_FINE][0]))
        counters.append(int(values[xbus.PACKET_COUNTER][0]))
        arrivals.append(message.received_ns)
        assert np.linalg.norm(values[xbus.MAGNETIC_FIELD]) == pytest.approx(1.0, abs=0.1)
        assert 85_000 < values[xbus.BARO_PRESSURE][0] < 100_000
    assert not rejects
    assert set(np.diff(ticks)) == {100}
    assert set(np.diff(counters) % 65536) == {1}
    # The clock drift is at most 20 ppm, and the transmission delay 3 to 5 ms.
    waiting = np.array(arrivals) - (np.array(ticks) - ticks[0]) * 100_000
    assert np.ptp(waiting) < 2e6 + 20e-6 * 60e9
    assert waiting.min() - DEFAULT_START_NS > 12e6


def test_the_accelerometer_axes_follow_the_configured_mounting() -> None:
    flat, turned = (
        World(BY_NAME["parking_lot"], 1, 0, Equipment(mounting_rpy_deg=mounting))
        for mounting in ((0.0, 0.0, 0.0), (0.0, 0.0, 90.0))
    )
    readings = []
    for world in (flat, turned):
        data = next(message.data for _, message in world if isinstance(message, ImuRaw))
        values = xbus.decode_mtdata2(data[4:-1], Counter())
        readings.append(np.array(values[xbus.ACCELERATION]))
    assert readings[0][2] == pytest.approx(9.80, abs=0.05), "z points up"
    # An IMU turned clockwise by 90 degrees has its x axis to the right and its y axis forward.
    assert readings[1] == pytest.approx([-readings[0][1], readings[0][0], readings[0][2]], abs=1e-5)


def test_the_messages_of_an_epoch_share_their_time_and_arrive_within_150_ms(minute: list[Message]) -> None:
    epochs: dict[int, list[tuple[int, str]]] = defaultdict(list)
    for received_ns, parsed in frames(minute):
        # After the epoch's NAV-EOE, so that no fix waits for them.
        if parsed.identity[:3] in ("RXM", "MON", "SEC") or parsed.identity == "NAV-SIG":
            assert epochs
            continue
        epochs[parsed.iTOW].append((received_ns, parsed.identity))
    assert len(epochs) in (59, 60)
    starts = []
    for itow, parts in sorted(epochs.items())[:-1]:
        assert [name for _, name in parts] == [
            "NAV-PVT", "NAV-HPPOSLLH", "NAV-DOP", "NAV-COV", "NAV-SAT", "NAV-STATUS", "NAV-CLOCK", "NAV-EOE"
        ]  # fmt: skip
        assert itow % 1000 == 0
        starts.append((parts[0][0] - itow * 1_000_000, parts[-1][0] - parts[0][0]))
    first, spread = np.array(starts).T
    # The host's offset to UTC is unknown here; only the variation is that of the delay.
    assert 1e6 < np.ptp(first) < 31e6
    assert 20e6 < spread.max() < 100e6


def test_the_speed_of_a_fix_is_the_true_speed_at_its_time_stamp() -> None:
    stream = list(messages("highway", 2, 90.0))
    truth = {message.sampled_ns: message for message in stream if isinstance(message, TruthState)}
    stamps = np.array(sorted(truth))
    speeds = np.array([np.hypot(*(truth[s].velocity_ned_m_s or (np.nan, np.nan))[:2]) for s in stamps])
    pvts = [(r, p) for r, p in frames(stream) if p.identity == "NAV-PVT"]
    measured = np.array([p.gSpeed * 1e-3 for _, p in pvts])
    best = min(range(-60, 61), key=lambda ms: float(
        np.abs(np.interp(_epochs(pvts) + ms * 1_000_000, stamps, speeds) - measured).sum()
    ))  # fmt: skip
    assert abs(best) < 40, "the host's clock started within 30 ms of UTC"
    error = np.interp(_epochs(pvts) + best * 1_000_000, stamps, speeds) - measured
    assert error.std() < 0.08


def _epochs(pvts: list[tuple[int, Any]]) -> npt.NDArray[np.int64]:
    """UTC of the epochs in ns: the start of the simulation is within the week."""
    week_ns = DEFAULT_START_NS - DEFAULT_START_NS % (7 * 86_400 * NS) + 3 * 86_400 * NS
    itow = np.array([p.iTOW for _, p in pvts], dtype=np.int64) * 1_000_000 - 18 * NS
    return week_ns + itow + (7 * 86_400 * NS if week_ns + itow[0] < DEFAULT_START_NS - 86_400 * NS else 0)


def test_a_new_rate_is_acknowledged_and_applied_from_the_next_epoch() -> None:
    world = World(BY_NAME["parking_lot"], 1, DEFAULT_START_NS, Equipment(protocols=("ubx",)))
    arrivals = iter(world)
    before = list(takewhile(lambda a: a[0] < DEFAULT_START_NS + 3 * NS, arrivals))
    now_ns = before[-1][0]
    wanted = [("CFG_RATE_MEAS", 100), *((f"CFG_MSGOUT_UBX_NAV_{name}_UART1", 10) for name in ("SAT", "SIG"))]
    world.write(valset(wanted), now_ns)
    world.write(valget(["CFG_RATE_MEAS"]), now_ns)
    after = list(takewhile(lambda a: a[0] < DEFAULT_START_NS + 8 * NS, arrivals))
    parsed = frames(message for _, message in [*before, *after])
    responses = [(r, p) for r, p in parsed if p.identity in ("ACK-ACK", "CFG-VALGET")]
    assert [p.identity for _, p in responses] == ["ACK-ACK", "CFG-VALGET", "ACK-ACK"]
    assert responses[0][0] - now_ns < 300_000_000, "after 2.7 kB of the epoch, at 11.5 kB/s"
    times = [p.iTOW for _, p in parsed if p.identity == "NAV-PVT"]
    assert np.diff(times).tolist() == sorted(np.diff(times).tolist(), reverse=True), "once slow, then fast"
    assert set(np.diff(times)) == {1000, 100}
    epochs = [p.iTOW for r, p in parsed if p.identity == "NAV-PVT" and r > now_ns + 1_200_000_000]
    assert len(epochs) > 30
    satellites = [p for r, p in parsed if p.identity == "NAV-SAT" and r > now_ns + 1_200_000_000]
    assert len(satellites) < len(epochs) / 5


def test_a_saturated_serial_line_skips_whole_epochs() -> None:
    world = World(BY_NAME["parking_lot"], 1, DEFAULT_START_NS)
    world.write(valset([("CFG_RATE_MEAS", 50)]), DEFAULT_START_NS)
    arrivals = takewhile(lambda a: a[0] < DEFAULT_START_NS + 10 * NS, world)
    pvts = [(r, p) for r, p in frames(message for _, message in arrivals) if p.identity == "NAV-PVT"]
    assert 30 < len(pvts) < 50, "2.7 kB per epoch at 11.5 kB/s"
    steps = np.diff([p.iTOW for _, p in pvts])
    assert steps.min() == 50
    assert steps.max() < 2000


def test_nav_pvt_has_no_fix_in_a_tunnel() -> None:
    pvts = [p for _, p in frames(messages("tunnel", 1, 130.0)) if p.identity == "NAV-PVT"]
    kinds = {(p.fixType, p.gnssFixOk, p.invalidLlh) for p in pvts}
    assert kinds == {(3, 1, 0), (0, 0, 1)}
    assert all(p.numSV == 0 for p in pvts if not p.fixType)


def test_a_receiver_that_holds_its_speed_in_a_tunnel_states_it_for_10_s_and_then_zero() -> None:
    def speeds(scenario: str) -> dict[int, tuple[bool, float, int]]:
        found = [p for _, p in frames(messages(scenario, 1, 130.0)) if p.identity == "NAV-PVT"]
        return {p.iTOW // 1000: (bool(p.gnssFixOk), p.gSpeed / 1000.0, p.numSV) for p in found}

    usual, held = speeds("tunnel"), speeds("tunnel-hold")
    lost = [second for second, (valid, _, _) in usual.items() if not valid]
    first = next(
        second for second in lost if second - 1 in usual and usual[second - 1][0] and usual[second - 1][1] > 5.0
    )
    before, inside = held[first - 1][1], [held[second] for second in lost if first <= second < first + 16]
    assert all(valid and satellites == 0 for valid, _, satellites in inside)
    assert [speed for _, speed, _ in inside[:10]] == [pytest.approx(before, abs=1e-3)] * 10
    assert len(inside) > 11 and {speed for _, speed, _ in inside[10:]} == {0.0}
    assert usual[first - 1] == held[first - 1], "the same before the tunnel"


def test_the_origin_states_a_simulation_every_2_s(minute: list[Message]) -> None:
    origins = [message for message in minute if isinstance(message, Origin)]
    assert {(o.kind, o.name, o.seed, o.speed) for o in origins} == {(OriginKind.SIMULATED, "parking_lot", 1, 1.0)}
    assert {b.now_ns - a.now_ns for a, b in pairwise(origins)} == {2 * NS}


@pytest.mark.slow
def test_the_clock_of_the_simulated_host_is_right_and_stated_every_10_s(minute: list[Message]) -> None:
    clocks = [m for m in minute if isinstance(m, HostClock)]
    assert len(clocks) in (6, 7)
    assert [c.sampled_ns for c in clocks] == [DEFAULT_START_NS + 10 * k * NS for k in range(len(clocks))]
    assert all(c.synchronised and c.utc_ns == c.sampled_ns for c in clocks)


def test_the_memory_of_a_long_drive_is_bounded() -> None:
    arrivals = (message for _, message in World(BY_NAME["urban"], 1, 0))
    for _ in islice(arrivals, 2_000):
        pass
    tracemalloc.start()
    try:
        for _ in islice(arrivals, 2_000):
            pass
        early = tracemalloc.get_traced_memory()[0]
        for _ in islice(arrivals, 4_000):
            pass
        late = tracemalloc.get_traced_memory()[0]
    finally:
        tracemalloc.stop()
    assert late - early < 100_000, "bytes; half a minute of messages is more than 0.5 MB"


def test_raw_messages_name_their_sources(minute: list[Message]) -> None:
    sources = {m.source for m in minute if isinstance(m, ImuRaw | GnssRaw | CanRaw)}
    assert sources == {"imu0", SOURCE, "can0"}


def test_the_baseline_of_two_antennas_is_the_heading_of_the_vehicle() -> None:
    scenario = replace(BY_NAME["tunnel"], carrier="fixed")
    world = World(scenario, 1, DEFAULT_START_NS, Equipment(protocols=("ubx",), second_antenna_m=1.0))
    end = DEFAULT_START_NS + 100 * NS
    stream = [message for due_ns, message in takewhile(lambda arrival: arrival[0] <= end, world)]
    truth = [m for m in stream if isinstance(m, TruthState)]
    yaw = np.unwrap([m.yaw_rad for m in truth if m.yaw_rad is not None])
    lines = [(at, m) for at, m in frames(stream) if m.identity == "NAV-RELPOSNED"]
    valid = [(at, m) for at, m in lines if m.relPosHeadingValid]
    assert len(lines) > 95 and 50 < len(valid) < len(lines), "none before the ambiguities are fixed"
    assert all(m.carrSoln == 2 and m.isMoving and m.relPosLength == 100 for _, m in valid)
    errors = []
    for at, line in valid:
        before = np.searchsorted([m.sampled_ns for m in truth], at) - 1
        if abs(yaw[before] - yaw[before - 3]) < np.radians(0.1):  # in a bend the heading changes during the delay
            errors.append(np.angle(np.exp(1j * (np.radians(line.relPosHeading) - yaw[before]))))
    assert len(errors) > 20 and np.degrees(np.abs(errors)).max() < 5.0 * valid[0][1].accHeading

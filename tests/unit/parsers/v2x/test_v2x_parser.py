import math
from collections import Counter
from itertools import pairwise

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from services.parsers.v2x.process import Config, Process
from services.sensors.v2x.process import MAX_BATCH_FRAMES
from shared.bus import codec
from shared.maths.earth import Geodetic, geodetic_from_ned_difference
from shared.messages.gnss import FixType, GnssFix
from shared.messages.v2x import (
    MAX_FRAME_BYTES,
    Authentication,
    Cam,
    CamContent,
    CamFrames,
    CamList,
    Encapsulation,
    OwnCam,
    StationType,
    Unverified,
    V2xSend,
)
from shared.topics import BY_NAME
from shared.v2x import frames, geonetworking, its_time
from shared.v2x.security.envelope import without_envelope
from tests.support.cases import each
from tests.support.data import recording
from tests.support.gnss.captures import packets
from tests.support.v2x import cams
from tests.support.v2x.signing import Ticket, signed

NOW_NS = 1_795_000_000 * 10**9 + 123_456_789
MS = 1_000_000


def packet(content: CamContent = cams.BRAKING, generated_ns: int = NOW_NS, header_ms: int = 0) -> bytes:
    return cams.packet(content, its_time.its_time_ms(generated_ns), header_ms)


def decoded(process: Process, batch: CamFrames) -> list[Cam]:
    lists = [message for message in process.handle(batch) if isinstance(message, CamList)]
    return [cam for cams in lists for cam in cams.cams]


def fix(latitude_deg: float, longitude_deg: float, utc_offset_ns: int = 0) -> GnssFix:
    return GnssFix(
        sampled_ns=NOW_NS,
        received_ns=NOW_NS,
        source="gnss0",
        utc_ns=NOW_NS + utc_offset_ns,
        fix_type=FixType.THREE_D,
        latitude_deg=latitude_deg,
        longitude_deg=longitude_deg,
    )


def test_a_batch_becomes_one_list_of_cams_with_their_stamps_and_frames() -> None:
    process = Process(Config())
    first, second = packet(), packet(cams.SILENT, NOW_NS - 40 * MS)
    data = frames.pack([(NOW_NS, first), (NOW_NS + 5 * MS, second)])
    (found,) = process.handle(CamFrames(received_ns=NOW_NS + 5 * MS, source="v2x0", data=data))
    assert isinstance(found, CamList)
    assert (found.source, found.received_ns) == ("v2x0", NOW_NS + 5 * MS)
    assert [cam.frame for cam in found.cams] == [first, second]
    assert [cam.received_ns for cam in found.cams] == [NOW_NS, NOW_NS + 5 * MS]
    assert [cam.station_id for cam in found.cams] == [4_000_000_123, 0]
    assert [cam.sampled_ns // MS for cam in found.cams] == [NOW_NS // MS, NOW_NS // MS - 40]
    assert found.cams[0].speed_m_s == 23.45
    assert found.cams[1].speed_m_s is found.cams[1].latitude_deg is None
    assert process.rejects == Counter()


def test_bare_uper_is_decoded_as_well() -> None:
    payload = geonetworking.decode_payload(packet())
    (found,) = decoded(Process(Config()), cams.batch([payload], NOW_NS, Encapsulation.NONE))
    assert found.station_id == 4_000_000_123
    assert found.frame == payload


def test_unusable_frames_are_counted_by_reason_and_the_rest_of_the_batch_is_decoded() -> None:
    process, good = Process(Config()), packet()
    bad = [
        b"",
        good[:30],
        b"\x21" + good[1:],
        b"\x12" + good[1:],
        good[:44] + b"\x01" + good[45:],
        good[:45] + b"\x01" + good[46:],
        good[:41] + b"\xd2" + good[42:],
        packet(generated_ns=NOW_NS - 10_000 * MS),
        packet(generated_ns=NOW_NS + 5_000 * MS),
    ]
    found = decoded(process, cams.batch([good, *bad, good], NOW_NS))
    assert [cam.frame for cam in found] == [good, good]
    assert process.rejects == Counter(
        {
            "truncated": 2,
            "geonetworking_version": 1,
            "security_version": 1,
            "protocol_version": 1,
            "message_id": 1,
            "port": 1,
            "too_old": 1,
            "from_the_future": 1,
        }
    )


def test_a_truncated_batch_is_counted_and_its_complete_frames_are_used() -> None:
    process = Process(Config())
    batch = cams.batch([packet(), packet()], NOW_NS)
    assert len(decoded(process, batch.model_copy(update={"data": batch.data[:-1]}))) == 1
    assert process.rejects == Counter({"batch": 1})


@settings(max_examples=200, deadline=None)
@given(st.binary(max_size=2000), st.sampled_from(Encapsulation))
def test_random_batches_are_counted_rejects(data: bytes, encapsulation: Encapsulation) -> None:
    process = Process(Config())
    batch = CamFrames(received_ns=NOW_NS, source="v2x0", encapsulation=encapsulation, data=data)
    found = decoded(process, batch)
    assert not data or found or sum(process.rejects.values()) > 0


@settings(max_examples=200, deadline=None)
@given(st.lists(st.tuples(st.integers(0, 10_000), st.integers(0, 255)), min_size=1, max_size=10))
def test_damaged_packets_are_valid_cams_or_counted_rejects(damage: list[tuple[int, int]]) -> None:
    process, damaged = Process(Config()), bytearray(packet())
    for place, value in damage:
        damaged[place % len(damaged)] = value
    messages = list(process.handle(cams.batch([bytes(damaged)], NOW_NS)))
    assert len(messages) + sum(process.rejects.values()) == 1
    for message in messages:
        codec.encode(message)


def test_generation_times_stay_in_order_across_the_wrap_of_generation_delta_time() -> None:
    wrap_ms = (its_time.its_time_ms(NOW_NS) // its_time.CYCLE_MS + 1) * its_time.CYCLE_MS
    wrap_ns = its_time.utc_ns_from_its_time(wrap_ms)
    process, found = Process(Config()), []
    for step in range(-5, 6):
        generated_ns = wrap_ns + step * 100 * MS
        found += decoded(process, cams.batch([packet(generated_ns=generated_ns)], generated_ns + 30 * MS))
    assert {cam.generation_delta_time for cam in found} >= {65436, 0, 100}
    assert [(b.sampled_ns - a.sampled_ns) for a, b in pairwise(found)] == [100 * MS] * 10
    assert {cam.received_ns - cam.sampled_ns for cam in found} == {30 * MS}


CYCLE_NS = its_time.CYCLE_MS * MS


@pytest.mark.parametrize("cycles", [1, 2, -1])
@pytest.mark.parametrize("encapsulation", Encapsulation)
def test_a_frame_replayed_after_a_cycle_of_generation_delta_time_is_refused_by_its_header(
    cycles: int, encapsulation: Encapsulation
) -> None:
    """The CAM alone looks new; without a header nothing tells the two apart here, and `core.toll` does."""
    process, sent = Process(Config()), packet()
    frame = sent if encapsulation is Encapsulation.GEONETWORKING else geonetworking.decode_payload(sent)
    assert len(decoded(process, cams.batch([frame], NOW_NS, encapsulation))) == 1
    again = decoded(process, cams.batch([frame], NOW_NS + cycles * CYCLE_NS, encapsulation))
    if encapsulation is Encapsulation.GEONETWORKING:
        assert again == [] and process.rejects == Counter({"header_time": 1})
    else:
        assert len(again) == 1


@pytest.mark.parametrize(("header_ms", "used"), [(0, True), (-990, True), (990, True), (-1010, False), (1010, False),
                                                 (65_536, False), (1 << 31, False)])  # fmt: skip
def test_the_header_may_differ_from_the_cam_by_a_second(header_ms: int, used: bool) -> None:
    process = Process(Config())
    assert bool(decoded(process, cams.batch([packet(header_ms=header_ms)], NOW_NS))) is used
    assert process.rejects == Counter({} if used else {"header_time": 1})


def test_the_header_is_compared_across_the_wrap_of_its_own_time() -> None:
    cycle_ms = geonetworking.TIME_CYCLE_MS
    wrap_ms = (its_time.its_time_ms(NOW_NS) // cycle_ms + 1) * cycle_ms
    for step_ms in (-40, 0, 40):
        received_ns = its_time.utc_ns_from_its_time(wrap_ms + step_ms) + 30 * MS
        batch = cams.batch([cams.packet(cams.BRAKING, wrap_ms + step_ms, header_ms=-50)], received_ns)
        assert len(decoded(Process(Config()), batch)) == 1


@pytest.mark.parametrize("offset_ms", [-1004, 0, 999])
def test_a_station_whose_clock_is_off_by_a_second_is_decoded_with_both_stamps(offset_ms: int) -> None:
    (found,) = decoded(Process(Config()), cams.batch([packet(generated_ns=NOW_NS + offset_ms * MS)], NOW_NS))
    assert found.received_ns == NOW_NS
    assert (found.sampled_ns - NOW_NS) / MS == pytest.approx(offset_ms, abs=1.0)


def test_the_time_line_of_the_unit_is_mapped_to_utc_by_the_receiver_and_not_by_the_hosts_clock() -> None:
    process = Process(Config())
    assert list(process.handle(fix(49.4, -1.1, utc_offset_ns=3600 * 10**9))) == []
    sent = packet(generated_ns=NOW_NS + 3600 * 10**9 - 50 * MS)
    (found,) = decoded(process, cams.batch([sent], NOW_NS))
    assert (NOW_NS - found.sampled_ns) / MS == pytest.approx(50.0, abs=1.0)


@pytest.mark.parametrize(("distance_m", "used"), [(9_900.0, True), (40_000.0, False)])
def test_a_station_40_km_away_is_rejected_when_the_own_position_is_known(distance_m: float, used: bool) -> None:
    process = Process(Config())
    far = Geodetic(math.radians(49.4431234), math.radians(-1.0993217), 0.0)
    here = geodetic_from_ned_difference((0.0, distance_m, 0.0), far)
    assert decoded(process, cams.batch([packet()], NOW_NS))
    list(process.handle(fix(math.degrees(here.latitude), math.degrees(here.longitude))))
    assert bool(decoded(process, cams.batch([packet()], NOW_NS))) is used
    assert process.rejects == Counter({} if used else {"too_far": 1})


def test_a_station_without_a_position_is_not_too_far() -> None:
    process = Process(Config())
    list(process.handle(fix(49.0, 2.0)))
    assert decoded(process, cams.batch([packet(cams.SILENT)], NOW_NS))


OWN = OwnCam(**dict(cams.BRAKING), sampled_ns=NOW_NS, its_time_ms=its_time.its_time_ms(NOW_NS))


def test_an_own_cam_becomes_a_packet_that_another_station_decodes() -> None:
    (sent,) = Process(Config()).handle(OWN)
    assert isinstance(sent, V2xSend)
    (found,) = decoded(Process(Config()), cams.batch([sent.data], NOW_NS))
    assert (found.station_id, found.speed_m_s, found.latitude_deg) == (4_000_000_123, 23.45, 49.4431234)
    assert found.sampled_ns // MS == NOW_NS // MS


def test_the_headers_reveal_no_more_than_the_pseudonym_and_say_whether_the_position_is_accurate() -> None:
    (sent,) = Process(Config()).handle(OWN)
    (unsafe,) = Process(Config()).handle(OWN.model_copy(update={"position_out_of_range": True}))
    assert isinstance(sent, V2xSend)
    assert isinstance(unsafe, V2xSend)
    assert sent.data[14:20] == b"\x02\x00" + (4_000_000_123).to_bytes(4, "big")
    assert (sent.data[32] >> 7, unsafe.data[32] >> 7) == (1, 0)


def test_an_own_frame_that_the_radio_receives_again_is_not_another_station() -> None:
    process = Process(Config())
    (sent,) = process.handle(OWN)
    assert isinstance(sent, V2xSend)
    assert decoded(process, cams.batch([sent.data], NOW_NS)) == []
    assert process.rejects == Counter({"own_station": 1})


def test_an_own_cam_without_a_position_is_counted_and_not_sent() -> None:
    process = Process(Config())
    assert list(process.handle(OWN.model_copy(update={"latitude_deg": None}))) == []
    assert process.rejects == Counter({"own_position": 1})


def test_the_cam_of_a_road_side_unit_is_marked_not_mobile() -> None:
    unit = OWN.model_copy(update={"station_type": StationType.ROAD_SIDE_UNIT})
    (sent,) = Process(Config()).handle(unit)
    assert isinstance(sent, V2xSend)
    assert sent.data[7] == 0


@pytest.mark.recording
def test_the_capture_of_the_test_system_is_decoded_although_its_clock_is_a_second_behind() -> None:
    process, ages_s = Process(Config()), []
    for utc_ns, data in packets(recording("etsi_cam_pcap/etsi-its-cam-unsecured.pcapng")):
        (found,) = decoded(process, cams.batch([data], utc_ns))
        assert (found.station_id, found.latitude_deg, found.longitude_deg) == (10143, 43.554663, 10.30419)
        ages_s.append((found.received_ns - found.sampled_ns) / 1e9)
    assert len(ages_s) == 10
    assert ages_s == pytest.approx([1.004] * 10, abs=0.01)
    assert process.rejects == Counter()


TICKET = Ticket()


@pytest.mark.parametrize("with_certificate", [True, False])
def test_a_signed_frame_is_a_cam_that_states_its_signer_and_that_nothing_is_verified(with_certificate: bool) -> None:
    process, generated_ms = Process(Config()), its_time.its_time_ms(NOW_NS - 40 * MS)
    plain = cams.packet(cams.BRAKING, generated_ms)
    frame = signed(plain, TICKET, generated_ms, with_certificate=with_certificate)
    unsigned, found = decoded(process, cams.batch([plain, frame], NOW_NS))
    assert (found.authentication, found.signer) == (Authentication.SIGNED_NOT_VERIFIED, TICKET.digest.hex())
    assert (unsigned.unverified, found.unverified) == (None, Unverified.NO_TRUST)
    assert (unsigned.authentication, unsigned.signer) == (Authentication.UNSIGNED, None)
    same = {"authentication": unsigned.authentication, "signer": None, "unverified": None, "frame": plain}
    assert found.frame == frame and found.model_copy(update=same) == unsigned
    assert process.rejects == Counter()


@pytest.mark.parametrize(("signed_ms", "reason"), [(0, None), (990, None), (-990, None), (1010, "generation_time"),
                                                   (-1010, "generation_time"), (65_536, "generation_time"),
                                                   (1 << 32, "generation_time")])  # fmt: skip
def test_the_time_of_a_signature_may_differ_from_the_cam_by_a_second(signed_ms: int, reason: str | None) -> None:
    process, generated_ms = Process(Config()), its_time.its_time_ms(NOW_NS)
    frame = signed(packet(), TICKET, generated_ms + signed_ms)
    assert bool(decoded(process, cams.batch([frame], NOW_NS))) is (reason is None)
    assert process.rejects == Counter({reason: 1} if reason else {})


@each(
    ("age_s", "reason"),
    [(10.0, "too_old"), (2.1, "too_old"), (-5.0, "from_the_future"), (its_time.CYCLE_MS / 1000, "header_time")],
)  # fmt: skip
def test_a_signed_frame_has_the_limits_of_unsigned_ones_and_is_two_seconds_old_at_most(
    age_s: float, reason: str
) -> None:
    process, generated_ns = Process(Config()), NOW_NS - round(age_s * 1e9)
    frame = signed(packet(generated_ns=generated_ns), TICKET, its_time.its_time_ms(generated_ns))
    assert decoded(process, cams.batch([frame], NOW_NS)) == []
    assert process.rejects == Counter({reason: 1})


@settings(max_examples=200, deadline=None)
@given(st.lists(st.tuples(st.integers(0, 10_000), st.integers(0, 255)), min_size=1, max_size=10))
def test_damaged_signed_packets_are_valid_cams_or_counted_rejects(damage: list[tuple[int, int]]) -> None:
    process, damaged = Process(Config()), bytearray(SIGNED)
    for place, value in damage:
        damaged[place % len(damaged)] = value
    messages = list(process.handle(cams.batch([bytes(damaged)], NOW_NS)))
    assert len(messages) + sum(process.rejects.values()) == 1
    assert process.rejects["fault"] == 0
    for message in messages:
        codec.encode(message)


SIGNED = signed(packet(), TICKET, its_time.its_time_ms(NOW_NS))


@pytest.mark.recording
def test_field_frames_are_too_old_at_their_capture_and_cam_at_the_time_that_they_state() -> None:
    live, by_their_time, ages_s = Process(Config()), Process(Config()), []
    for utc_ns, frame in packets(recording("cam_secured/field_secured_cam.pcapng")):
        assert decoded(live, cams.batch([frame], utc_ns)) == []
        _, envelope = without_envelope(frame)
        assert envelope is not None
        signed_ns = its_time.utc_ns_from_its_time(envelope.generation_time_ms)
        ages_s.append((utc_ns - signed_ns) / 1e9)
        (found,) = decoded(by_their_time, cams.batch([frame], signed_ns))
        assert (found.authentication, found.station_id) == (Authentication.SIGNED_NOT_VERIFIED, 469_130_859)
        assert found.signer == "6999ac931bf65e6b"
    assert live.rejects == Counter({"too_old": 9})
    assert by_their_time.rejects == Counter()
    assert all(18.6 < age_s < 19.1 for age_s in ages_s)


@pytest.mark.parametrize("count", [1, 24, 25, 1024])
def test_a_batch_of_any_size_becomes_lists_that_the_broker_passes_on(count: int) -> None:
    content = cams.BRAKING
    assert content.low_frequency is not None
    path = content.low_frequency.path[:1] * 40
    longest = content.model_copy(update={"low_frequency": content.low_frequency.model_copy(update={"path": path})})
    data = frames.pack((NOW_NS + k, packet(longest)) for k in range(count))
    batch = CamFrames.model_construct(received_ns=NOW_NS, source="v2x", data=data)
    lists = list(Process(Config()).handle(batch))
    assert [cam.received_ns for cams in lists if isinstance(cams, CamList) for cam in cams.cams] == [
        NOW_NS + k for k in range(count)
    ]
    assert all(len(codec.encode(cams)) + 300 <= BY_NAME["v2x/cam"].most_bytes for cams in lists)


def test_a_batch_of_the_longest_frames_fits_into_a_message() -> None:
    data = frames.pack((NOW_NS, bytes(MAX_FRAME_BYTES)) for _ in range(MAX_BATCH_FRAMES))
    batch = CamFrames(received_ns=NOW_NS, source="v2x", data=data)
    assert len(codec.encode(batch)) + 300 <= BY_NAME["v2x/raw"].most_bytes

"""What travels on the bus comes back as it was, or is refused with a reason."""

import json
import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from shared.bus import codec
from shared.bus.envelope import make_envelope
from shared.errors import BadPayload
from shared.messages.base import Vector3
from shared.messages.gnss import FixType, GnssFix, GnssRaw
from shared.messages.imu import ImuSamples
from shared.messages.navigation import NavigationSolution
from shared.messages.operation import ProcessHealth, ProcessState
from shared.messages.vehicle import CanRaw
from shared.topics import TOPICS
from tests.support.status_world import solution

FIX = GnssFix(
    sampled_ns=1, received_ns=2, source="gnss", fix_type=FixType.THREE_D, latitude_deg=48.1, longitude_deg=11.5
)
finite = st.floats(allow_nan=False, allow_infinity=False)
vector = st.tuples(finite, finite, finite)


def test_a_message_comes_back_as_it_was() -> None:
    payload, properties = codec.encode(FIX)
    assert codec.decode("gnss/fix", payload, properties) == FIX


def test_what_is_missing_is_left_out() -> None:
    payload, _ = codec.encode(FIX)
    assert "height_ellipsoid_m" not in json.loads(payload)


def test_a_solution_of_an_older_unit_opens_without_protection_levels() -> None:
    """Recordings from before they were computed: what is missing is unknown, and not a level of zero."""
    old = solution(0)
    payload, properties = codec.encode(old)
    assert (
        not {"protection_level_horizontal_m", "protection_level_vertical_m", "integrity_risk"}
        & json.loads(payload).keys()
    )
    found = codec.decode("navigation/solution", payload, properties)
    assert found == old and isinstance(found, NavigationSolution)
    assert found.protection_level_horizontal_m is None and found.integrity_risk is None


def test_raw_bytes_travel_unchanged_beside_their_stamp() -> None:
    message = GnssRaw(received_ns=5, source="gnss", data=bytes(range(256)))
    payload, properties = codec.encode(message)
    assert payload == bytes(range(256))
    assert codec.decode("gnss/raw", payload, properties) == message


def test_a_message_of_a_process_carries_the_process_in_its_topic() -> None:
    health = ProcessHealth(process="core.fusion", state=ProcessState.READY, incarnation=1, sent_ns=2)
    assert codec.topic_name(health) == "health/core.fusion"
    assert codec.decode("health/core.fusion", codec.encode(health)[0], {}) == health


@given(st.lists(st.tuples(st.integers(0, 2**62), vector, vector), min_size=1, max_size=20))
def test_inertial_samples_lose_no_digit(rows: list[tuple[int, Vector3, Vector3]]) -> None:
    stamps, forces, rates = zip(*rows, strict=True)
    samples = ImuSamples(
        received_ns=1, source="imu", sampled_ns=stamps, specific_force_body_m_s2=forces, angular_rate_body_rad_s=rates
    )
    assert codec.decode("imu/sample", codec.encode(samples)[0], {}) == samples


@pytest.mark.parametrize(
    "payload",
    [
        b"", b"{", b"[]", b"null", b"\xff\xfe", b'{"sampled_ns": 1}',
        b'{"sampled_ns":1,"received_ns":2,"source":"g","fix_type":"three_d","latitude_deg":NaN}',
        b'{"sampled_ns":1,"received_ns":2,"source":"g","fix_type":"three_d","latitude_deg":"48.1"}',
        b'{"sampled_ns":1,"received_ns":2,"source":"g","fix_type":"three_d","latitude_deg":true}',
        b'{"sampled_ns":1,"received_ns":2,"source":"g","fix_type":"three_d","latitude_deg":91.0}',
        b'{"sampled_ns":1.5,"received_ns":2,"source":"g","fix_type":"three_d"}',
        b'{"sampled_ns":1,"received_ns":2,"source":"g","fix_type":"four_d"}',
    ],
)  # fmt: skip
def test_a_payload_that_breaks_the_contract_is_refused(payload: bytes) -> None:
    with pytest.raises(BadPayload):
        codec.decode("gnss/fix", payload, {})


def test_a_field_of_a_newer_producer_is_ignored() -> None:
    document = json.loads(codec.encode(FIX)[0]) | {"invented_later_m": 1.0}
    assert codec.decode("gnss/fix", json.dumps(document).encode(), {}) == FIX


def test_raw_bytes_without_their_stamp_are_refused() -> None:
    with pytest.raises(BadPayload, match="received_ns"):
        codec.decode("can/raw", b"", {"source": "can"})
    with pytest.raises(BadPayload):
        codec.decode("can/raw", b"", {"source": "can", "received_ns": "soon"})
    for digits in (str(2**63), 310 * "9", "-" + 4000 * "9", 5000 * "9"):
        with pytest.raises(BadPayload):
            codec.decode("can/raw", b"", {"source": "can", "received_ns": digits})
    with pytest.raises(BadPayload, match="letters"):
        codec.decode("can/raw", b"", {"source": 49 * "c", "received_ns": "1"})
    assert isinstance(codec.decode("can/raw", b"", {"source": "can", "received_ns": "1"}), CanRaw)


def test_an_unknown_topic_and_an_oversized_payload_are_refused() -> None:
    with pytest.raises(BadPayload, match="no topic"):
        codec.decode("gnss/secret", b"{}", {})
    with pytest.raises(BadPayload, match="bytes"):
        codec.decode("gnss/fix", b" " * (codec.MAXIMUM_PAYLOAD + 1), {})


@given(st.sampled_from([t.name.replace("+", "core.fusion") for t in TOPICS]), st.binary(max_size=300))
def test_noise_is_refused_and_nothing_else_happens(name: str, noise: bytes) -> None:
    try:
        codec.decode(name, noise, {"received_ns": "1", "source": "x"})
    except BadPayload:
        return
    assert name.endswith("/raw") or name == "gnss/write"


def test_an_envelope_without_sender_is_refused() -> None:
    whole = {"from": "core.fusion", "life": "1", "seq": "2", "source": "x"}
    envelope = make_envelope("gnss/fix", b"{}", whole, received_ns=1)
    assert envelope is not None
    assert (envelope.producer, envelope.incarnation, envelope.sequence) == ("core.fusion", 1, 2)
    assert envelope.properties == {"source": "x"}
    for missing in ("from", "life", "seq"):
        assert make_envelope("gnss/fix", b"{}", {k: v for k, v in whole.items() if k != missing}, received_ns=1) is None
    assert make_envelope("gnss/fix", b"{}", whole | {"seq": "two"}, received_ns=1) is None
    assert make_envelope("no/topic", b"{}", whole, received_ns=1) is None


def test_not_a_number_cannot_be_put_into_a_message() -> None:
    with pytest.raises(ValueError, match="finite"):
        GnssFix(sampled_ns=1, received_ns=2, source="g", fix_type=FixType.NONE, hdop=math.nan)


def test_a_process_cannot_speak_for_another() -> None:
    health = ProcessHealth(process="core.fusion", state=ProcessState.READY, incarnation=1, sent_ns=2)
    with pytest.raises(BadPayload, match="speaks for"):
        codec.decode("health/parsers.gnss", codec.encode(health)[0], {})


@pytest.mark.parametrize(
    "change",
    [
        {"sampled_ns": 10**400}, {"received_ns": -(10**400)}, {"height_ellipsoid_m": 1e300}, {"height_msl_m": -1e300},
        {"velocity_ned_m_s": [1e300, 0.0, 0.0]}, {"position_sd_ned_m": [1.0, 1e300, 1.0]},
        {"velocity_sd_ned_m_s": [-1.0, 1.0, 1.0]}, {"ground_speed_m_s": 1e300},
    ],
)  # fmt: skip
def test_numbers_that_no_sensor_can_say_are_refused_at_the_door(change: dict[str, object]) -> None:
    document = json.loads(codec.encode(FIX)[0]) | change
    with pytest.raises(BadPayload):
        codec.decode("gnss/fix", json.dumps(document).encode(), {})


def test_a_source_leaves_room_for_what_parsers_append() -> None:
    with pytest.raises(BadPayload):
        codec.decode("gnss/raw", b"", {"source": "x" * 49, "received_ns": "1"})

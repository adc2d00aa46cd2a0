"""Encoded messages are decoded unchanged, or rejected with a reason."""

import base64
import json
import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from shared.bus import codec
from shared.bus.envelope import Envelope
from shared.errors import BadPayload
from shared.maths.dates import END_DATE_NS
from shared.messages.base import MAX_VALUE, Sender, Vector3
from shared.messages.gnss import FixType, GnssFix, GnssRaw
from shared.messages.imu import ImuSamples
from shared.messages.navigation import NavigationSolution
from shared.messages.operation import ProcessHealth, ProcessState
from shared.messages.vehicle import CanRaw
from shared.topics import TOPICS
from tests.support.cases import each
from tests.support.dashboard.status_world import solution

FIX = GnssFix(
    sampled_ns=1, received_ns=2, source="gnss", fix_type=FixType.THREE_D, latitude_deg=48.1, longitude_deg=11.5
)
SENDER = Sender(process="core.fusion", incarnation=1, sequence=2)
finite = st.floats(-MAX_VALUE, MAX_VALUE)
vector = st.tuples(finite, finite, finite)


def test_a_decoded_message_equals_the_encoded_one() -> None:
    payload = codec.encode(FIX)
    assert codec.decode("gnss/fix", payload) == FIX


def test_missing_values_are_omitted() -> None:
    payload = codec.encode(FIX)
    assert "height_ellipsoid_m" not in json.loads(payload)


def test_a_solution_of_an_older_unit_opens_without_protection_levels() -> None:
    """In recordings of earlier versions protection levels are None, and not zero."""
    old = solution(0)
    payload = codec.encode(old)
    assert (
        not {"protection_level_horizontal_m", "protection_level_vertical_m", "integrity_risk"}
        & json.loads(payload).keys()
    )
    found = codec.decode("navigation/solution", payload)
    assert found == old and isinstance(found, NavigationSolution)
    assert found.protection_level_horizontal_m is None and found.integrity_risk is None


@given(st.binary(max_size=300))
def test_raw_bytes_are_encoded_as_base64_with_their_stamp(data: bytes) -> None:
    message = GnssRaw(received_ns=5, source="gnss", data=data)
    payload = codec.encode(message)
    assert json.loads(payload) == {"received_ns": 5, "source": "gnss", "data": base64.b64encode(data).decode()}
    assert codec.decode("gnss/raw", payload) == message


def test_the_topic_of_a_process_message_names_the_process() -> None:
    health = ProcessHealth(process="core.fusion", state=ProcessState.READY, incarnation=1, sent_ns=2)
    assert codec.topic_name(health) == "health/core.fusion"
    assert codec.decode("health/core.fusion", codec.encode(health)) == health


@given(st.lists(st.tuples(st.integers(0, END_DATE_NS - 1), vector, vector), min_size=1, max_size=20))
def test_inertial_samples_are_encoded_without_rounding(rows: list[tuple[int, Vector3, Vector3]]) -> None:
    stamps, forces, rates = zip(*rows, strict=True)
    samples = ImuSamples(
        received_ns=1, source="imu", sampled_ns=stamps, specific_force_body_m_s2=forces, angular_rate_body_rad_s=rates
    )
    assert codec.decode("imu/sample", codec.encode(samples)) == samples


@each(
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
def test_a_payload_that_violates_the_contract_is_rejected(payload: bytes) -> None:
    with pytest.raises(BadPayload):
        codec.decode("gnss/fix", payload)


def test_a_field_of_a_newer_producer_is_ignored() -> None:
    document = json.loads(codec.encode(FIX)) | {"invented_later_m": 1.0}
    assert codec.decode("gnss/fix", json.dumps(document).encode()) == FIX


@each(
    "change",
    [
        {"data": "A"}, {"data": "AA=A"}, {"data": "AAAA\n"}, {"data": "AA-_"}, {"data": "é"}, {"data": None},
        {"data": 1},
        {"data": "AAAA" * (1 << 17) + "AAAA" * 50_000}, {"received_ns": None}, {"received_ns": "soon"},
        {"received_ns": 2**63}, {"received_ns": int(310 * "9")}, {"received_ns": -int(4000 * "9")},
        {"source": 49 * "c"},
    ],
)  # fmt: skip
def test_raw_bytes_that_violate_the_contract_are_rejected(change: dict[str, object]) -> None:
    good = {"received_ns": 1, "source": "can", "data": "AAAA"}
    assert isinstance(codec.decode("can/raw", json.dumps(good).encode()), CanRaw)
    with pytest.raises(BadPayload):
        codec.decode("can/raw", json.dumps(good | change).encode())


def test_an_unknown_topic_and_an_oversized_payload_are_rejected() -> None:
    with pytest.raises(BadPayload, match="no topic"):
        codec.decode("gnss/secret", b"{}")
    with pytest.raises(BadPayload, match="bytes"):
        codec.decode("gnss/fix", b" " * (codec.MAXIMUM_PAYLOAD + 1))


@given(st.sampled_from([t.name.replace("+", "core.fusion") for t in TOPICS]), st.binary(max_size=300))
def test_random_bytes_are_rejected(name: str, noise: bytes) -> None:
    with pytest.raises(BadPayload):
        codec.decode(name, noise)
    with pytest.raises(BadPayload):
        Envelope.of(name, noise, 1)


def test_a_payload_holds_its_sender_and_the_unchanged_message() -> None:
    payload = codec.signed(codec.encode(FIX), SENDER)
    assert json.loads(payload) == {"sender": SENDER.model_dump(exclude_none=True), **json.loads(codec.encode(FIX))}
    envelope = Envelope.of("gnss/fix", payload, 1)
    assert (envelope.producer, envelope.incarnation, envelope.sequence) == ("core.fusion", 1, 2)
    assert envelope.decode() == FIX


@pytest.mark.parametrize(
    "change",
    [
        {"process": None}, {"process": 65 * "x"}, {"incarnation": "1"}, {"incarnation": 2**63}, {"sequence": -1},
        {"sequence": 1.5}, {"sequence": int(310 * "9")},
    ],
)  # fmt: skip
def test_a_payload_without_a_valid_sender_is_rejected(change: dict[str, object]) -> None:
    body = {"sender": SENDER.model_dump() | change, "sampled_ns": 1}
    with pytest.raises(BadPayload, match="sender: "):
        Envelope.of("gnss/fix", json.dumps(body, separators=(",", ":")).encode(), 1)


def test_a_payload_that_is_nested_long_or_of_no_topic_is_rejected() -> None:
    payload = codec.signed(codec.encode(FIX), SENDER)
    for topic, hostile in (
        ("gnss/secret", payload), ("gnss/fix", payload + b" " * codec.MAXIMUM_PAYLOAD),
        ("gnss/fix", payload[:-1] + b',"a":' + b"[" * 100_000), ("gnss/fix", b'{"sender":' * 10_000),
        ("gnss/fix", b'{"sender":'), ("gnss/fix", b""), ("gnss/fix", b"\xff"),
    ):  # fmt: skip
        with pytest.raises(BadPayload):
            Envelope.of(topic, hostile, 1).decode()


def test_nan_is_rejected_in_a_message() -> None:
    with pytest.raises(ValueError, match="finite"):
        GnssFix(sampled_ns=1, received_ns=2, source="g", fix_type=FixType.NONE, hdop=math.nan)


def test_a_process_cannot_publish_for_another() -> None:
    health = ProcessHealth(process="core.fusion", state=ProcessState.READY, incarnation=1, sent_ns=2)
    with pytest.raises(BadPayload, match="carries a message of"):
        codec.decode("health/parsers.gnss", codec.encode(health))


@each(
    "change",
    [
        {"sampled_ns": 10**400}, {"received_ns": -(10**400)}, {"height_ellipsoid_m": 1e300}, {"height_msl_m": -1e300},
        {"velocity_ned_m_s": [1e300, 0.0, 0.0]}, {"position_sd_ned_m": [1.0, 1e300, 1.0]},
        {"velocity_sd_ned_m_s": [-1.0, 1.0, 1.0]}, {"ground_speed_m_s": 1e300},
    ],
)  # fmt: skip
def test_implausible_values_of_a_sensor_are_rejected_on_decoding(change: dict[str, object]) -> None:
    document = json.loads(codec.encode(FIX)) | change
    with pytest.raises(BadPayload):
        codec.decode("gnss/fix", json.dumps(document).encode())

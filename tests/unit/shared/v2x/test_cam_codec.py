import math
from pathlib import Path
from typing import Any

import asn1tools
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from shared.errors import RejectedFrame
from shared.messages.v2x import CamContent, StationType
from shared.v2x import cam
from tests.support.cases import each
from tests.support.v2x import cams

# Of a CAM of the ETSI test system, without its headers: standing passenger car, 1 Hz.
TEST_SYSTEM = bytes.fromhex("02020000279fed2d4059f35a60ce2dc3ad800200200030d41e0000012016840310a50733ffe1fffa001000")


def test_the_test_systems_cam_decodes_to_what_it_states_and_encodes_to_the_same_bytes() -> None:
    content, generation_delta_time = cams.decode_content(TEST_SYSTEM)
    assert generation_delta_time == 60717
    assert (content.station_id, content.station_type) == (10143, StationType.PASSENGER_CAR)
    assert (content.latitude_deg, content.longitude_deg) == (43.554663, 10.30419)
    assert (content.speed_m_s, content.speed_confidence_m_s) == (0.45, 0.05)
    assert content.heading_confidence_rad == pytest.approx(math.radians(1.0))
    assert (content.vehicle_length_m, content.vehicle_width_m) == (5.0, 2.1)
    assert content.longitudinal_acceleration_m_s2 is None
    assert content.height_confidence_m is None
    assert content.yaw_rate_rad_s == 0.0
    assert cam.encode(content, generation_delta_time) == TEST_SYSTEM


def test_a_cam_of_another_implementation_decodes_to_what_others_read_in_it() -> None:
    """From issue 156 of pycrate, 2021: a parked car with three optional elements, also read by an online decoder."""
    payload = bytes.fromhex(
        "02020000D900B1E74059D824554CC4C2D79FFFFFFC2230D41E58622FC0000082B88A800FFD01FFF8807FE013C0400009FFFF7FFFD8CE00"
    )
    content, generation_delta_time = cams.decode_content(payload)
    assert (content.station_id, generation_delta_time) == (55552, 45543)
    assert content.station_type is StationType.PASSENGER_CAR
    assert (content.latitude_deg, content.longitude_deg) == (42.128017, -8.622778)
    assert (content.position_semi_major_m, content.height_confidence_m, content.drive_direction) == (None, None, None)
    assert (content.vehicle_length_m, content.vehicle_width_m) == (4.4, 1.8)
    assert content.low_frequency is not None
    assert len(content.low_frequency.path) == 1


@settings(max_examples=100, deadline=None)
@given(cams.contents(), st.integers(0, 65535))
def test_a_cam_with_values_on_the_grid_of_its_codes_survives_encoding(content: CamContent, time_ms: int) -> None:
    decoded, decoded_time_ms = cams.decode_content(cam.encode(content, time_ms))
    assert decoded_time_ms == time_ms
    assert_equal(decoded.model_dump(), content.model_dump())


def assert_equal(a: Any, b: Any) -> None:
    if isinstance(a, dict):
        assert a.keys() == b.keys()
        for name, value in a.items():
            assert_equal(value, b[name])
    elif isinstance(a, tuple | list):
        assert len(a) == len(b)
        for item, other in zip(a, b, strict=True):
            assert_equal(item, other)
    elif isinstance(a, float):
        assert a == pytest.approx(b, rel=1e-9, abs=1e-12)
    else:
        assert a == b


# Path of the code in the decoded record; name of the element; (code, value in SI units) of legal values; codes of None.
ELEMENTS: list[tuple[str, str, list[tuple[int, float]], list[int]]] = [
    ("position.latitude", "latitude_deg", [(900_000_000, 90.0), (-900_000_000, -90.0)], [900_000_001]),
    ("position.longitude", "longitude_deg", [(1_800_000_000, 180.0), (-1_800_000_000, -180.0)], [1_800_000_001]),
    ("ellipse.semiMajorConfidence", "position_semi_major_m", [(0, 0.0), (4093, 40.93)], [4094, 4095]),
    ("ellipse.semiMinorConfidence", "position_semi_minor_m", [(1, 0.01), (4093, 40.93)], [4094, 4095]),
    ("ellipse.semiMajorOrientation", "position_semi_major_orientation_rad", [(900, math.pi / 2), (3600, 0.0)], [3601]),
    ("altitude.altitudeValue", "height_ellipsoid_m", [(-100_000, -1000.0), (800_000, 8000.0)], [800_001]),
    ("heading.headingValue", "heading_rad", [(0, 0.0), (3599, math.radians(359.9)), (3600, 0.0)], [3601]),
    ("heading.headingConfidence", "heading_confidence_rad", [(125, math.radians(12.5))], [126, 127]),
    ("speed.speedValue", "speed_m_s", [(0, 0.0), (16_382, 163.82)], [16_383]),
    ("speed.speedConfidence", "speed_confidence_m_s", [(1, 0.01), (125, 1.25)], [126, 127]),
    ("length.vehicleLengthValue", "vehicle_length_m", [(1, 0.1), (1021, 102.1)], [1022, 1023]),
    ("motion.vehicleWidth", "vehicle_width_m", [(1, 0.1), (60, 6.0)], [61, 62]),
    ("acceleration.longitudinalAccelerationValue", "longitudinal_acceleration_m_s2",
     [(-160, -16.0), (160, 16.0)], [161]),
    ("acceleration.longitudinalAccelerationConfidence", "longitudinal_acceleration_confidence_m_s2",
     [(100, 10.0)], [101, 102]),
    ("curvature.curvatureValue", "curvature", [(-1023, -0.1023), (1022, 0.1022)], [1023]),
    ("yaw.yawRateValue", "yaw_rate_rad_s",
     [(32_766, math.radians(327.66)), (-32_766, math.radians(-327.66)), (100, math.radians(1.0))], [32_767]),
]  # fmt: skip


def parts(record: dict[str, Any]) -> dict[str, dict[str, Any]]:
    """Name the records inside a decoded CAM that hold the codes."""
    parameters = record["cam"]["camParameters"]
    position, motion = parameters["basicContainer"]["referencePosition"], parameters["highFrequencyContainer"][1]
    return {
        "position": position,
        "ellipse": position["positionConfidenceEllipse"],
        "altitude": position["altitude"],
        "motion": motion,
        "heading": motion["heading"],
        "speed": motion["speed"],
        "length": motion["vehicleLength"],
        "acceleration": motion["longitudinalAcceleration"],
        "curvature": motion["curvature"],
        "yaw": motion["yawRate"],
    }


def decoded_with(path: str, code: int) -> CamContent:
    record = cam.specification().decode("CAM", TEST_SYSTEM)
    part, name = path.split(".")
    parts(record)[part][name] = code
    return cams.decode_content(cam.specification().encode("CAM", record))[0]


@each(("path", "element", "legal", "missing"), ELEMENTS)
def test_special_codes_are_none_and_the_codes_beside_them_are_values(
    path: str, element: str, legal: list[tuple[int, float]], missing: list[int]
) -> None:
    for code, value in legal:
        assert getattr(decoded_with(path, code), element) == pytest.approx(value, abs=1e-12), code
    for code in missing:
        assert getattr(decoded_with(path, code), element) is None, code


def test_an_axis_out_of_range_means_an_untrusted_position() -> None:
    assert decoded_with("ellipse.semiMajorConfidence", 4094).position_out_of_range
    assert decoded_with("ellipse.semiMinorConfidence", 4094).position_out_of_range
    assert not decoded_with("ellipse.semiMajorConfidence", 4095).position_out_of_range


@pytest.mark.parametrize(
    ("path", "code"),
    [("heading.headingValue", 3602), ("ellipse.semiMajorOrientation", 4095), ("altitude.altitudeValue", 800_002)],
)
def test_a_code_that_fits_its_bits_but_not_its_range_is_rejected(path: str, code: int) -> None:
    with pytest.raises(RejectedFrame, match="uper"):
        decoded_with(path, code)


def test_values_beyond_the_range_of_their_code_are_saturated_and_not_unavailable() -> None:
    fast = cams.BRAKING.model_copy(
        update={
            "speed_m_s": 500.0,
            "height_ellipsoid_m": 9000.0,
            "yaw_rate_rad_s": 10.0,
            "curvature": -1.0,
            "longitudinal_acceleration_m_s2": -50.0,
        }
    )
    decoded, _ = cams.decode_content(cam.encode(fast, 0))
    assert decoded.speed_m_s == 163.82
    assert decoded.height_ellipsoid_m == 8000.0
    assert decoded.yaw_rate_rad_s == pytest.approx(math.radians(327.66))
    assert decoded.curvature == -0.1023
    assert decoded.longitudinal_acceleration_m_s2 == -16.0


def test_a_confidence_is_rounded_up_and_too_large_a_one_is_out_of_range() -> None:
    content = cams.BRAKING.model_copy(
        update={
            "position_semi_major_m": 41.0,
            "position_semi_minor_m": 1.231,
            "speed_confidence_m_s": 1.26,
            "heading_confidence_rad": math.radians(2.11),
            "height_confidence_m": 6.0,
            "curvature_confidence": 0.2,
            "yaw_rate_confidence_rad_s": math.radians(0.11),
        }
    )
    decoded, _ = cams.decode_content(cam.encode(content, 0))
    assert (decoded.position_semi_major_m, decoded.position_out_of_range) == (None, True)
    assert decoded.position_semi_minor_m == 1.24
    assert decoded.speed_confidence_m_s is None
    assert decoded.heading_confidence_rad == pytest.approx(math.radians(2.2))
    assert decoded.height_confidence_m == 10.0
    assert decoded.curvature_confidence is None
    assert decoded.yaw_rate_confidence_rad_s == pytest.approx(math.radians(1.0))


def test_an_untrusted_position_is_sent_with_its_code_for_any_ellipse() -> None:
    untrusted = cams.BRAKING.model_copy(update={"position_out_of_range": True})
    decoded, _ = cams.decode_content(cam.encode(untrusted, 0))
    assert decoded.position_out_of_range
    assert decoded.position_semi_major_m is None
    assert decoded.latitude_deg == cams.BRAKING.latitude_deg


def test_a_heading_just_below_a_full_turn_is_north() -> None:
    turned = cams.BRAKING.model_copy(update={"heading_rad": math.radians(359.97)})
    assert cams.decode_content(cam.encode(turned, 0))[0].heading_rad == 0.0


def test_extensions_of_a_later_version_are_skipped() -> None:
    """TS 103 900 adds containers at such marks."""
    text = Path(cam.__file__).with_name("cam.asn").read_text()
    for old, new in (
        ("SpecialVehicleContainer OPTIONAL,\n    ...", "SpecialVehicleContainer OPTIONAL, ..., more OCTET STRING"),
        (
            "    referencePosition ReferencePosition,\n    ...",
            "    referencePosition ReferencePosition, ..., n INTEGER",
        ),
    ):
        assert old in text
        text = text.replace(old, new)
    later = asn1tools.compile_string(text, "uper")
    record = cam.specification().decode("CAM", TEST_SYSTEM)
    record["cam"]["camParameters"]["more"] = bytes(range(50))
    record["cam"]["camParameters"]["basicContainer"]["n"] = 123_456_789
    extended = later.encode("CAM", record)
    assert len(extended) > len(TEST_SYSTEM) + 50
    assert cams.decode_content(extended) == cams.decode_content(TEST_SYSTEM)


def test_a_station_type_without_a_name_is_other() -> None:
    record = cam.specification().decode("CAM", TEST_SYSTEM)
    record["cam"]["camParameters"]["basicContainer"]["stationType"] = 200
    assert cams.decode_content(cam.specification().encode("CAM", record))[0].station_type is StationType.OTHER


@pytest.mark.parametrize(
    ("payload", "reason"),
    [
        (b"", "truncated"),
        (b"\x02", "truncated"),
        (b"\x01" + TEST_SYSTEM[1:], "protocol_version"),
        (b"\x03" + TEST_SYSTEM[1:], "protocol_version"),
        (b"\x02\x01" + TEST_SYSTEM[2:], "message_id"),
        (TEST_SYSTEM[:20], "uper"),
    ],
)
def test_a_message_that_is_no_cam_of_this_version_is_rejected_with_its_reason(payload: bytes, reason: str) -> None:
    with pytest.raises(RejectedFrame) as rejected:
        cam.decode(payload)
    assert rejected.value.reason == reason


@each("length", range(len(TEST_SYSTEM)))
def test_a_truncated_cam_is_rejected(length: int) -> None:
    with pytest.raises(RejectedFrame):
        cam.decode(TEST_SYSTEM[:length])


@settings(max_examples=500, deadline=None)
@given(st.binary(max_size=300))
def test_random_bytes_behind_a_valid_header_are_decoded_or_rejected(tail: bytes) -> None:
    try:
        content, _ = cams.decode_content(TEST_SYSTEM[:8] + tail)
    except RejectedFrame as error:
        assert error.reason == "uper"
    else:
        assert content.station_id == 10143


@settings(max_examples=300, deadline=None)
@given(st.lists(st.tuples(st.integers(16, 8 * len(TEST_SYSTEM) - 1)), min_size=1, max_size=8))
def test_flipped_bits_are_decoded_or_rejected(places: list[tuple[int]]) -> None:
    damaged = bytearray(TEST_SYSTEM)
    for (place,) in places:
        damaged[place // 8] ^= 1 << place % 8
    try:
        cams.decode_content(bytes(damaged))
    except RejectedFrame as error:
        assert error.reason == "uper"

"""Oracle: the dissectors of Wireshark, in a process of their own."""

import math
from pathlib import Path

import pytest

from shared.messages.v2x import StationType
from shared.v2x import cam, geonetworking
from tests.support.data import recording
from tests.support.gnss.captures import Dissection, dissect, dissect_file, packets
from tests.support.v2x import cams


def codes(seen: Dissection) -> dict[str, int]:
    """Name the codes that tshark shows after the elements of `CamContent`."""
    return {
        "station_id": seen.number("its.stationID"),
        "latitude_deg": seen.number("its.latitude"),
        "longitude_deg": seen.number("its.longitude"),
        "position_semi_major_m": seen.number("its.semiMajorConfidence"),
        "position_semi_minor_m": seen.number("its.semiMinorConfidence"),
        "position_semi_major_orientation_rad": seen.number("its.semiMajorOrientation"),
        "height_ellipsoid_m": seen.number("its.altitudeValue"),
        "height_confidence_m": seen.number("its.altitudeConfidence"),
        "heading_rad": seen.number("its.headingValue"),
        "heading_confidence_rad": seen.number("its.headingConfidence"),
        "speed_m_s": seen.number("its.speedValue"),
        "speed_confidence_m_s": seen.number("its.speedConfidence"),
        "drive_direction": seen.number("cam.driveDirection"),
        "vehicle_length_m": seen.number("its.vehicleLengthValue"),
        "trailer": seen.number("its.vehicleLengthConfidenceIndication"),
        "vehicle_width_m": seen.number("cam.vehicleWidth"),
        "longitudinal_acceleration_m_s2": seen.number("its.longitudinalAccelerationValue"),
        "longitudinal_acceleration_confidence_m_s2": seen.number("its.longitudinalAccelerationConfidence"),
        "curvature": seen.number("its.curvatureValue"),
        "curvature_confidence": seen.number("its.curvatureConfidence"),
        "yaw_rate_rad_s": seen.number("its.yawRateValue"),
        "yaw_rate_confidence_rad_s": seen.number("its.yawRateConfidence"),
    }


# Codes of `cams.BRAKING`, worked out by hand from the units of TS 102 894-2.
BRAKING_CODES = {
    "station_id": 4_000_000_123,
    "latitude_deg": 494_431_234,
    "longitude_deg": -10_993_217,
    "position_semi_major_m": 123,
    "position_semi_minor_m": 45,
    "position_semi_major_orientation_rad": 317,
    "height_ellipsoid_m": -1234,
    "height_confidence_m": 8,
    "heading_rad": 2713,
    "heading_confidence_rad": 21,
    "speed_m_s": 2345,
    "speed_confidence_m_s": 31,
    "drive_direction": 0,
    "vehicle_length_m": 46,
    "trailer": 1,
    "vehicle_width_m": 19,
    "longitudinal_acceleration_m_s2": -34,
    "longitudinal_acceleration_confidence_m_s2": 6,
    "curvature": 123,
    "curvature_confidence": 3,
    "yaw_rate_rad_s": 1652,
    "yaw_rate_confidence_rad_s": 2,
}
SILENT_CODES = {
    "station_id": 0,
    "latitude_deg": 900_000_001,
    "longitude_deg": 1_800_000_001,
    "position_semi_major_m": 4095,
    "position_semi_minor_m": 4095,
    "position_semi_major_orientation_rad": 3601,
    "height_ellipsoid_m": 800_001,
    "height_confidence_m": 15,
    "heading_rad": 3601,
    "heading_confidence_rad": 127,
    "speed_m_s": 16_383,
    "speed_confidence_m_s": 127,
    "drive_direction": 2,
    "vehicle_length_m": 1023,
    "trailer": 4,
    "vehicle_width_m": 62,
    "longitudinal_acceleration_m_s2": 161,
    "longitudinal_acceleration_confidence_m_s2": 102,
    "curvature": 1023,
    "curvature_confidence": 7,
    "yaw_rate_rad_s": 32_767,
    "yaw_rate_confidence_rad_s": 8,
}


def test_tshark_dissects_an_encoded_cam_to_its_values(tmp_path: Path) -> None:
    untrusted = cams.BRAKING.model_copy(update={"position_out_of_range": True})
    contents = [cams.BRAKING, cams.SILENT, untrusted]
    seen = dissect([geonetworking.encode_packet(cam.encode(c, 54321), cams.SENDER) for c in contents], tmp_path)
    assert not any(frame.malformed for frame in seen)
    assert [frame.number("cam.generationDeltaTime") for frame in seen] == [54321] * 3
    assert [frame.number("cam.stationType") for frame in seen] == [5, 0, 5]
    assert codes(seen[0]) == BRAKING_CODES
    assert codes(seen[1]) == SILENT_CODES
    assert codes(seen[2]) == BRAKING_CODES | {"position_semi_major_m": 4094, "position_semi_minor_m": 4094}


def test_tshark_dissects_an_encoded_low_frequency_container_to_its_values(tmp_path: Path) -> None:
    (seen,) = dissect([geonetworking.encode_packet(cam.encode(cams.BRAKING, 0), cams.SENDER)], tmp_path)
    assert seen.number("cam.vehicleRole") == 12
    assert seen.all("cam.exteriorLights") == ["a1"]
    assert seen.all("its.deltaLatitude") == ["-123", "131071"]
    assert seen.all("its.deltaLongitude") == ["456", "-131071"]
    assert seen.all("its.deltaAltitude") == ["-25", "12800"]
    assert seen.all("its.pathDeltaTime") == ["150"]


def test_tshark_dissects_a_road_side_unit_without_motion(tmp_path: Path) -> None:
    unit = cams.SILENT.model_copy(update={"station_type": StationType.ROAD_SIDE_UNIT})
    (seen,) = dissect([geonetworking.encode_packet(cam.encode(unit, 0), cams.SENDER, mobile=False)], tmp_path)
    assert not seen.malformed
    assert (seen.number("cam.stationType"), seen.number("cam.highFrequencyContainer")) == (15, 1)
    assert seen.number("geonw.ch.flags.mob") == 0


def test_tshark_dissects_encoded_headers_to_their_values(tmp_path: Path) -> None:
    (seen,) = dissect([geonetworking.encode_packet(cam.encode(cams.BRAKING, 0), cams.SENDER)], tmp_path)
    expected = {
        "geonw.bh.version": 1,
        "geonw.bh.nh": 1,  # common header
        "geonw.bh.lt.mult": 1,
        "geonw.bh.lt.base": 1,  # 1 s
        "geonw.bh.rhl": 1,
        "geonw.ch.nh": 2,  # BTP-B
        "geonw.ch.htype": 0x50,  # single-hop broadcast
        "geonw.ch.tc.id": 2,
        "geonw.ch.flags.mob": 1,
        "geonw.ch.mhl": 1,
        "geonw.src_pos.addr.manual": 0,
        "geonw.src_pos.addr.type": 5,
        "geonw.src_pos.tst": 1_535_174_982,
        "geonw.src_pos.lat": 494_431_234,
        "geonw.src_pos.long": -10_993_217,
        "geonw.src_pos.pai": 1,
        "geonw.src_pos.speed": 2345,
        "geonw.src_pos.hdg": 2713,
        "btpb.dstport": 2001,
    }
    assert {name: seen.number(name) for name in expected} == expected
    assert seen.all("geonw.src_pos.addr.mid") == ["02:00:12:34:56:78"]


@pytest.mark.recording
def test_the_ten_frames_of_the_test_system_decode_to_what_tshark_shows() -> None:
    capture = recording("etsi_cam_pcap/etsi-its-cam-unsecured.pcapng")
    seen, ours = dissect_file(capture), packets(capture)
    assert len(seen) == len(ours) == 10
    for frame, (_, packet) in zip(seen, ours, strict=True):
        content, generation_delta_time = cams.decode_content(geonetworking.decode_payload(packet))
        shown = codes(frame)
        assert generation_delta_time == frame.number("cam.generationDeltaTime")
        assert content.station_id == shown["station_id"] == 10143
        assert content.latitude_deg == shown["latitude_deg"] / 1e7
        assert content.longitude_deg == shown["longitude_deg"] / 1e7
        assert content.position_semi_major_m == shown["position_semi_major_m"] / 100
        assert content.speed_m_s == shown["speed_m_s"] / 100
        assert content.heading_rad == pytest.approx(math.radians(shown["heading_rad"] / 10))
        assert content.longitudinal_acceleration_m_s2 is None
        assert shown["longitudinal_acceleration_m_s2"] == 161
        assert content.yaw_rate_rad_s == pytest.approx(math.radians(shown["yaw_rate_rad_s"] / 100))
        assert cam.encode(content, generation_delta_time) == geonetworking.decode_payload(packet)

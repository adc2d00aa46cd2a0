"""Neighbours from received CAM: state, quality, carrier frequency offset, and what is left out."""

import json
import socket
from base64 import b64encode
from collections import Counter
from math import cos, hypot, radians, sin

import numpy as np
import pytest

from services.parsers.v2x.neighbours import ReceivedNeighbours, neighbour_of
from services.parsers.v2x.process import Config, Process
from shared.devices.v2x_device import open_radio
from shared.maths.confidence import ELLIPSE_95, SCALAR_95
from shared.maths.earth import Geodetic, ned_from_geodetic_difference
from shared.messages.base import Tick
from shared.messages.neighbours import MAX_NEIGHBOURS, NeighbourStates
from shared.messages.v2x import Authentication, Cam, CamFrames, StationType
from shared.v2x import frames
from tests.unit.parsers.v2x.test_v2x_parser import NOW_NS, packet

HEADING = radians(60.0)


def cam(**changes: object) -> Cam:
    given: dict[str, object] = {
        "station_id": 7, "station_type": StationType.PASSENGER_CAR, "latitude_deg": 49.0, "longitude_deg": 1.1,
        "position_semi_major_m": 4.9, "position_semi_minor_m": 2.45, "position_semi_major_orientation_rad": HEADING,
        "height_ellipsoid_m": 100.0, "height_confidence_m": 3.92, "heading_rad": HEADING,
        "heading_confidence_rad": 0.0196, "speed_m_s": 20.0, "speed_confidence_m_s": 0.392,
        "sampled_ns": NOW_NS, "received_ns": NOW_NS, "generation_delta_time": 0, "frame": b"x",
    }  # fmt: skip
    return Cam.model_validate({**given, **changes})


def test_the_covariances_are_those_of_the_stated_confidences() -> None:
    found = neighbour_of(cam(), 1234.5, NOW_NS)
    assert found is not None and found.cfo_hz == 1234.5 and not found.authenticated
    assert found.velocity_ned_m_s == pytest.approx((20.0 * cos(HEADING), 20.0 * sin(HEADING), 0.0))
    nn, ne, _, ee, _, dd = found.position_cov_ned_m2
    values = np.linalg.eigvalsh([[nn, ne], [ne, ee]])
    assert np.sqrt(values) == pytest.approx([2.45 / ELLIPSE_95, 4.9 / ELLIPSE_95])
    along = np.array([cos(HEADING), sin(HEADING)])
    assert along @ [[nn, ne], [ne, ee]] @ along == pytest.approx(values[1]), "the greater axis lies along the road"
    assert dd == pytest.approx((3.92 / SCALAR_95) ** 2 + 1.0)
    vn, vne, _, ve, _, _ = found.velocity_cov_ned_m2_s2
    sds = np.sqrt(np.linalg.eigvalsh([[vn, vne], [vne, ve]]))
    assert sds == pytest.approx([0.392 / SCALAR_95, hypot(20.0 * 0.0196 / SCALAR_95, 0.01)], rel=1e-3)


@pytest.mark.parametrize("heading_deg", [0.0, 60.0, 179.0, 300.0])
def test_a_state_is_moved_on_to_the_common_time(heading_deg: float) -> None:
    heading = radians(heading_deg)
    found = neighbour_of(cam(heading_rad=heading), None, NOW_NS + 800_000_000)
    assert found is not None
    here = Geodetic(radians(found.latitude_deg), radians(found.longitude_deg), 0.0)
    north, east = ned_from_geodetic_difference(here, Geodetic(radians(49.0), radians(1.1), 0.0))[:2]
    assert (north, east) == pytest.approx((16.0 * cos(heading), 16.0 * sin(heading)), abs=0.06)
    fresh = neighbour_of(cam(heading_rad=heading), None, NOW_NS)
    assert fresh is not None and found.position_cov_ned_m2[0] > fresh.position_cov_ned_m2[0]


@pytest.mark.parametrize(
    "missing",
    ["position_semi_major_m", "speed_confidence_m_s", "heading_rad", "height_confidence_m", "latitude_deg"],
)
def test_without_a_stated_quality_there_is_no_neighbour(missing: str) -> None:
    assert neighbour_of(cam(**{missing: None}), None, NOW_NS) is None
    assert neighbour_of(cam(position_out_of_range=True), None, NOW_NS) is None
    assert neighbour_of(cam(station_type=StationType.ROAD_SIDE_UNIT), None, NOW_NS) is None


def test_authenticated_stations_come_first_and_unsigned_ones_do_not_replace_them() -> None:
    rejects: Counter[str] = Counter()
    known = ReceivedNeighbours(rejects)
    for station in range(2000):
        known.note(cam(station_id=station), b"frame")
    signed = cam(station_id=5, authentication=Authentication.AUTHENTICATED, signer="0" * 16)
    known.note(signed, b"frame")
    known.note(cam(station_id=5, speed_m_s=90.0), b"frame")
    states = known.states(NOW_NS, "v2x0")
    assert states is not None and len(states.neighbours) == MAX_NEIGHBOURS
    first = states.neighbours[0]
    assert (first.station_id, first.authenticated) == (5, True) and hypot(*first.velocity_ned_m_s) < 21.0
    assert rejects == {"neighbour_unsigned": 1}
    assert known.states(NOW_NS + 2_000_000_000, "v2x0") is None, "none of them is new enough"


def test_a_flood_of_unsigned_stations_displaces_no_authenticated_one() -> None:
    known = ReceivedNeighbours(Counter())
    known.note(cam(station_id=5, authentication=Authentication.AUTHENTICATED, signer="0" * 16), b"frame")
    for station in range(100, 3000):
        known.note(cam(station_id=station), b"frame")
    states = known.states(NOW_NS, "v2x0")
    assert states is not None and states.neighbours[0].station_id == 5
    assert [one.authenticated for one in states.neighbours] == [True] + [False] * (MAX_NEIGHBOURS - 1)
    for station in range(3000, 5000):
        known.note(cam(station_id=station, authentication=Authentication.AUTHENTICATED, signer="0" * 16), b"frame")
    states = known.states(NOW_NS, "v2x0")
    assert states is not None and min(one.station_id for one in states.neighbours) > 3900, "the oldest go"


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_state_is_moved_on_over_the_date_line(sign: float) -> None:
    heading = sign * radians(90.0)
    found = neighbour_of(cam(longitude_deg=sign * 179.99999, heading_rad=heading, speed_m_s=30.0), None, NOW_NS + 10**9)
    assert found is not None
    moved_deg = 30.0 / (111_320.0 * cos(radians(49.0)))
    assert found.longitude_deg == pytest.approx(sign * (179.99999 + moved_deg - 360.0), abs=1e-9)


@pytest.mark.parametrize("latitude_deg", [90.0, -90.0, 89.99999, -89.99999])
def test_at_a_pole_there_is_no_neighbour_and_the_others_are_published(latitude_deg: float) -> None:
    rejects: Counter[str] = Counter()
    known = ReceivedNeighbours(rejects)
    known.note(cam(station_id=1, latitude_deg=latitude_deg, heading_rad=0.0, speed_m_s=160.0), b"frame")
    known.note(cam(station_id=2), b"frame")
    states = known.states(NOW_NS + 10**9, "v2x0")
    assert states is not None and [one.station_id for one in states.neighbours] == [2]
    known.note(cam(station_id=3, latitude_deg=89.9, heading_rad=0.0, speed_m_s=1e6), b"frame")
    assert known.states(NOW_NS + 10**9, "v2x0") is not None and rejects == {"neighbour_impossible": 1}


def test_a_radio_that_measures_offsets_gives_them_to_the_neighbours() -> None:
    """From JSON over UDP to v2x/neighbours; what is no such object is counted."""
    rejects: Counter[str] = Counter()
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    radio = open_radio(f"udp+json://127.0.0.1:{port}", None, rejects)
    frame = packet()
    good = {"frame": b64encode(frame).decode(), "freqofs": -4321.0}
    bad = [b"{", b"[]", b'{"frame": 3}', b'{"frame": "%%"}', b'{"frame": ""}', b"[" * 3000]
    unknown = [json.dumps({**good, "freqofs": value}).encode() for value in ("1", True, 1e9, float("nan"))]
    try:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
            for data in (*bad, *unknown, json.dumps(good).encode()):
                sender.sendto(data, ("127.0.0.1", port))
        arrived = radio.read(100)
        offsets = radio.cfo_hz
    finally:
        radio.close()
    assert rejects == {"frame_json": len(bad)}
    assert [data for _, data in arrived] == [frame] * 5 and offsets == [None] * 4 + [-4321.0]

    process = Process(Config(neighbours=True))
    batch = CamFrames(received_ns=NOW_NS, source="v2x0", data=frames.pack([(NOW_NS, frame)]), cfo_hz=(-4321.0,))
    assert list(process.handle(batch))
    states = [m for m in process.handle(Tick(now_ns=NOW_NS)) if isinstance(m, NeighbourStates)]
    assert [neighbour.cfo_hz for one in states for neighbour in one.neighbours] == [-4321.0]
    assert not list(Process(Config()).handle(Tick(now_ns=NOW_NS))), "it has to be switched on"

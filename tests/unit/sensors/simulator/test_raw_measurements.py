"""The simulator's raw measurements: least squares of them are its fixes, and its navigation words its orbits."""

from collections.abc import Iterator
from math import cos, degrees, radians

import numpy as np
import pytest

from services.core.cooperative.broadcast.ephemeris import satellite_state
from services.core.cooperative.broadcast.store import EphemerisStore
from services.core.cooperative.measurements import Constellation, Measurement, RawEpoch, SatelliteId
from services.core.cooperative.satellites.model import ErrorModel, Sky, usable_sights
from services.core.cooperative.satellites.solution import fit_position, fit_velocity, solution_of
from services.parsers.gnss.process import Config, Process
from services.sensors.simulator.gnss.navigation_words import gps_words
from services.sensors.simulator.gnss.orbits import UPLOAD_S
from services.sensors.simulator.gnss.raw_measurements import CLOCK_DRIFT, IONOSPHERE, clock_bias_s
from services.sensors.simulator.gnss.sky import SkyModel
from services.sensors.simulator.world import messages
from shared.maths.earth import geodetic_from_ecef, ned_from_ecef
from shared.maths.ellipsoid import curvature_radii
from shared.maths.gnss_signals import SPEED_OF_LIGHT
from shared.messages.gnss import GnssFix, GnssNavigationBits, GnssRaw, GnssRawEpoch

NS = 1_000_000_000
# Equal weights: the residuals are orthogonal to position and clock in the plain sense.
EQUAL = ErrorModel(elevation_mask_rad=radians(5.0), signal_in_space_sd_m=1e5, range_rate_sd_m_s=1.0, min_cn0_db_hz=0.0)
Parsed = list[GnssFix | GnssRawEpoch | GnssNavigationBits]


def parsed(scenario: str, seed: int, duration_s: float) -> Parsed:
    """Messages of parsers.gnss for the bytes of the simulator."""
    process = Process(Config())
    raw = (message for message in messages(scenario, seed, duration_s) if isinstance(message, GnssRaw))
    found = [message for gnss_raw in raw for message in process.handle(gnss_raw)]
    assert not process.rejects
    return [item for item in found if isinstance(item, GnssFix | GnssRawEpoch | GnssNavigationBits)]


def raw_epoch(message: GnssRawEpoch) -> RawEpoch:
    return RawEpoch(message.gps_time_ns, tuple(
        Measurement(SatelliteId(Constellation(m.constellation.value), m.number), m.pseudorange_m, m.doppler_hz)
        for m in message.measurements if m.pseudorange_m is not None
    ))  # fmt: skip


def filled(stream: Parsed, gps_time_ns: int) -> EphemerisStore:
    store = EphemerisStore()
    for gnss_navigation_bits in stream:
        if isinstance(gnss_navigation_bits, GnssNavigationBits):
            store.add_words(
                SatelliteId(Constellation(gnss_navigation_bits.constellation.value), gnss_navigation_bits.number),
                gnss_navigation_bits.words,
                gps_time_ns,
            )
    assert not store.rejected
    store.ionosphere = IONOSPHERE
    return store


def pairs(stream: Parsed) -> Iterator[tuple[GnssFix, GnssRawEpoch]]:
    """Fixes and raw measurements of the same epochs."""
    fixes = {
        gnss_fix.sampled_ns: gnss_fix
        for gnss_fix in stream
        if isinstance(gnss_fix, GnssFix) and gnss_fix.latitude_deg is not None
    }
    for gnss_raw_epoch in stream:
        if isinstance(gnss_raw_epoch, GnssRawEpoch) and gnss_raw_epoch.sampled_ns in fixes:
            yield fixes[gnss_raw_epoch.sampled_ns], gnss_raw_epoch


@pytest.mark.parametrize(("scenario", "seed"), [("parking_lot", 1), ("urban", 2), ("degraded", 3)])
def test_least_squares_of_the_measurements_are_the_fix(scenario: str, seed: int) -> None:
    """Within 2 mm, and 1 cm/s: the range-rate of the monitor neglects the change of the flight time, 2 to 4 mm/s."""
    stream = parsed(scenario, seed, 60.0)
    both = list(pairs(stream))
    assert len(both) > 50
    store = filled(stream, both[0][1].gps_time_ns)
    solved = 0
    for fix, message in both:
        sights, rejected = usable_sights(raw_epoch(message), store, EQUAL)
        if rejected:  # a satellite that rose during the drive may lack its ephemeris
            assert set(rejected) == {"no_ephemeris"}
            continue
        found = fit_position(Sky(sights, message.gps_time_ns, IONOSPHERE, EQUAL), None)
        assert found is not None
        velocity = fit_velocity(found, 1e-9)
        assert velocity is not None and fix.velocity_ned_m_s is not None
        x, y, z = solution_of(found, velocity).position_e
        place = geodetic_from_ecef((x, y, z))
        meridian, normal = curvature_radii(place.latitude)
        assert fix.latitude_deg is not None and fix.longitude_deg is not None
        north = (degrees(place.latitude) - fix.latitude_deg) * radians(1.0) * meridian
        east = (degrees(place.longitude) - fix.longitude_deg) * radians(1.0) * normal * cos(place.latitude)
        assert (north, east, place.height) == pytest.approx((0.0, 0.0, fix.height_ellipsoid_m), abs=2e-3)
        velocity_n = ned_from_ecef(place.latitude, place.longitude) @ np.array(velocity.velocity_e)
        assert velocity_n == pytest.approx(np.array(fix.velocity_ned_m_s), abs=1e-2)
        assert velocity.drift == pytest.approx(SPEED_OF_LIGHT * CLOCK_DRIFT, abs=1e-2)
        bias_m = found.fit.parameters[3 + found.clocks[Constellation.GPS]]
        assert bias_m == pytest.approx(SPEED_OF_LIGHT * clock_bias_s(message.gps_time_ns * 1e-9), abs=2e-2)
        assert found.fit.dof > 3 and np.abs(found.fit.residuals).max() > 0.05, "noise is there"
        solved += 1
    assert solved > 20


def test_satellite_positions_follow_from_their_navigation_words() -> None:
    model, gps_s = SkyModel(("gps", "galileo"), (1,)), 1.474e9 + 1234.5
    stream = parsed("parking_lot", 1, 40.0)
    (first, *_) = (gnss_raw_epoch for gnss_raw_epoch in stream if isinstance(gnss_raw_epoch, GnssRawEpoch))
    store = filled(stream, first.gps_time_ns)
    assert len(store.satellites()) > 10
    for satellite in store.satellites():
        ephemeris = store.select(satellite, first.gps_time_ns)
        assert not isinstance(ephemeris, str) and ephemeris.healthy
        assert abs(ephemeris.toe_ns - first.gps_time_ns) <= UPLOAD_S // 2 * NS
    of = model.orbits.broadcast(gps_s)
    now, later = (model.orbits.position_e(of, np.array(gps_s - of.toe_s + dt), np.arange(54)) for dt in (0.0, 1.0))
    assert np.linalg.norm(later - now, axis=1).max() < 4000.0
    before, after = (
        model.orbits.position_e(model.orbits.broadcast(of.toe_s + dt), np.array(half), np.arange(54))
        for dt, half in ((0.0, UPLOAD_S / 2), (float(UPLOAD_S), -UPLOAD_S / 2))
    )
    assert np.linalg.norm(after - before, axis=1).max() < 0.1, "[m] an upload moves a satellite by rounding only"


def test_the_broadcast_elements_give_the_simulated_positions_in_the_users_algorithm() -> None:
    model, gps_s = SkyModel(("gps", "galileo"), (1,)), 1_474_001_234
    store = EphemerisStore()
    for satellite in range(30):
        one = model.orbits.elements(gps_s, satellite)
        for end_s in range(gps_s // 30 * 30 + 6, gps_s // 30 * 30 + 36, 6):
            words = gps_words(one, end_s, IONOSPHERE)
            assert words is not None
            store.add_words(SatelliteId(Constellation.GPS, one.number), words, end_s * NS)
        ephemeris = store.select(SatelliteId(Constellation.GPS, one.number), gps_s * NS)
        assert not isinstance(ephemeris, str)
        of = model.orbits.broadcast(gps_s)
        simulated = model.orbits.position_e(of, np.array(float(gps_s - of.toe_s)), np.array([satellite]))[0]
        assert np.array(satellite_state(ephemeris, gps_s * NS).position_e) == pytest.approx(simulated, abs=1e-4)


def test_the_ionosphere_is_broadcast_every_twelve_and_a_half_minutes() -> None:
    one, store = SkyModel(("gps",), (1,)).orbits.elements(1_474_000_000, 0), EphemerisStore()
    received: list[int] = []
    for end_s in range(1_474_000_000, 1_474_001_500):
        if words := gps_words(one, end_s, IONOSPHERE):
            store.ionosphere = None
            store.add_words(SatelliteId(Constellation.GPS, one.number), words, end_s * NS)
            if store.ionosphere is not None:
                assert store.ionosphere == IONOSPHERE
                received.append(end_s)
    assert len(received) == 2 and received[1] - received[0] == 750
    assert not store.rejected


def test_one_second_of_all_messages_fits_the_serial_line() -> None:
    """11,520 bytes/s at 115,200 baud; UBX and NMEA together, with four constellations."""
    sent: dict[int, int] = {}
    for message in messages("parking_lot", 1, 60.0):
        if isinstance(message, GnssRaw):
            sent[message.received_ns // NS] = sent.get(message.received_ns // NS, 0) + len(message.data)
    assert 1000 < max(sent.values()) < 6000

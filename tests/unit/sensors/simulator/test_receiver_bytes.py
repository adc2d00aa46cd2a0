"""Output and responses of the simulated receiver, decoded by independent libraries."""

import pickle
from collections.abc import Iterator
from datetime import UTC, datetime
from math import degrees, hypot, radians, sqrt
from typing import Any

import numpy as np
import pytest
from pyubx2.ubxtypes_configdb import UBX_CONFIG_DATABASE

from services.sensors.simulator.gnss import nmea_encoder, receiver_settings, ubx_encoder
from services.sensors.simulator.gnss.receiver_settings import Settings
from services.sensors.simulator.gnss.reception import Fix
from services.sensors.simulator.gnss.simulated_epoch import GEOID_M, Epoch
from services.sensors.simulator.gnss.sky import CONSTELLATIONS, Sky, SkyModel, dilution
from shared.maths.earth import Geodetic
from shared.protocols.ubx import MAX_PAYLOAD, ubx_frame
from tests.support.gnss.ublox import parse_nmea, parse_ubx, valget, valset

PLACE = Geodetic(radians(42.370012345), radians(13.350098765), 712.3456)
NAMES = ("gps", "galileo", "glonass", "beidou")
UTC_MS = 1_790_000_001_200  # 2026-09-21T14:13:21.2Z
SKY = SkyModel(NAMES, (1,))


def epoch(
    *,
    valid: bool = True,
    carrier: str = "none",
    place: Geodetic = PLACE,
    velocity: tuple[float, float, float] = (3.0, -4.0, 0.1),
) -> Epoch:
    fix = Fix(valid, carrier, place, velocity, (0.0, 0.0, 0.0), (0.25, 0.3, 0.4), (0.05, 0.06, 0.08))
    sky = SKY.at(UTC_MS * 1e-3, place, mask_deg=10.0, loss_db=0.0, covered=not valid)
    return Epoch(UTC_MS, fix, sky, tuple(SKY.rows))


def test_nav_pvt_encodes_the_fix() -> None:
    pvt = parse_ubx(ubx_encoder.nav_pvt(epoch(carrier="float")))
    assert pvt.identity == "NAV-PVT"
    assert (pvt.year, pvt.month, pvt.day, pvt.hour, pvt.min, pvt.second) == (2026, 9, 21, 14, 13, 21)
    assert pvt.nano == 200_000_000
    # 2026-09-21 is a Monday; GPS time is 18 s ahead.
    assert pvt.iTOW == ((24 + 14) * 3600 + 13 * 60 + 21 + 18) * 1000 + 200
    assert (pvt.validDate, pvt.validTime, pvt.fullyResolved) == (1, 1, 1)
    assert (pvt.fixType, pvt.gnssFixOk, pvt.diffSoln, pvt.carrSoln) == (3, 1, 1, 1)
    assert pvt.lat == pytest.approx(degrees(PLACE.latitude), abs=5.1e-8)
    assert pvt.lon == pytest.approx(degrees(PLACE.longitude), abs=5.1e-8)
    assert pvt.height == 712_346
    assert pvt.hMSL == 712_346 - 1000 * GEOID_M
    assert (pvt.velN, pvt.velE, pvt.velD, pvt.gSpeed) == (3000, -4000, 100, 5000)
    assert pvt.headMot == pytest.approx(306.8699, abs=1e-4)
    assert pvt.hAcc == pytest.approx(1000 * hypot(0.25, 0.3), abs=1)
    assert pvt.vAcc == 400
    assert pvt.sAcc == pytest.approx(1000 * sqrt(0.05**2 + 0.06**2 + 0.08**2), abs=1)
    assert pvt.numSV == epoch().satellites_used > 15
    assert pvt.pDOP == pytest.approx(epoch().sky.dop.position, abs=0.01)
    assert pvt.lastCorrectionAge == 1


def test_an_autonomous_fix_reports_no_corrections() -> None:
    pvt = parse_ubx(ubx_encoder.nav_pvt(epoch()))
    assert (pvt.diffSoln, pvt.carrSoln, pvt.lastCorrectionAge, pvt.invalidLlh) == (0, 0, 0, 0)


def test_without_signals_there_is_no_fix_and_the_position_is_flagged_invalid() -> None:
    lost = epoch(valid=False)
    pvt, cov, high = (
        parse_ubx(ubx_encoder.nav_pvt(lost)),
        parse_ubx(ubx_encoder.nav_cov(lost)),
        parse_ubx(ubx_encoder.nav_hpposllh(lost)),
    )
    assert (pvt.fixType, pvt.gnssFixOk, pvt.numSV, pvt.invalidLlh) == (0, 0, 0, 1)
    assert pvt.pDOP == 99.99
    assert (cov.posCovValid, cov.velCovValid, high.invalidLlh) == (0, 0, 1)


@pytest.mark.parametrize("place", [PLACE, Geodetic(radians(-33.123456789), radians(-151.987654321), -12.3456)])
def test_nav_hpposllh_has_the_position_to_a_tenth_of_a_millimetre(place: Geodetic) -> None:
    high = parse_ubx(ubx_encoder.nav_hpposllh(epoch(place=place)))
    assert high.lat == pytest.approx(degrees(place.latitude), abs=5.1e-10)
    assert high.lon == pytest.approx(degrees(place.longitude), abs=5.1e-10)
    assert high.height == pytest.approx(1000 * place.height, abs=0.051)
    assert high.hAcc == pytest.approx(1000 * hypot(0.25, 0.3), abs=0.1)


def test_nav_cov_and_nav_dop_are_consistent_with_the_other_messages() -> None:
    cov, dop = parse_ubx(ubx_encoder.nav_cov(epoch())), parse_ubx(ubx_encoder.nav_dop(epoch()))
    assert [cov.posCovNN, cov.posCovEE, cov.posCovDD] == pytest.approx([0.0625, 0.09, 0.16])
    assert [cov.velCovNN, cov.velCovEE, cov.velCovDD] == pytest.approx([0.0025, 0.0036, 0.0064])
    assert (cov.posCovNE, cov.posCovND, cov.posCovED) == (0.0, 0.0, 0.0)
    assert dop.hDOP == pytest.approx(hypot(dop.nDOP, dop.eDOP), abs=0.011)
    assert dop.pDOP == pytest.approx(hypot(dop.hDOP, dop.vDOP), abs=0.011)
    assert dop.gDOP == pytest.approx(hypot(dop.pDOP, dop.tDOP), abs=0.011)


def test_nav_sat_lists_the_satellites() -> None:
    now = epoch()
    sat = parse_ubx(ubx_encoder.nav_sat(now))
    assert sat.numSvs == len(now.sky.number) > 25
    used = [getattr(sat, f"svUsed_{i:02d}") for i in range(1, sat.numSvs + 1)]
    assert sum(used) == now.satellites_used
    assert {getattr(sat, f"gnssId_{i:02d}") for i in range(1, sat.numSvs + 1)} == {0, 2, 3, 6}
    assert sat.elev_01 == round(now.sky.elevation_deg[0])
    assert sat.cno_01 == round(now.sky.cn0_db_hz[0])
    assert parse_ubx(ubx_encoder.nav_eoe(now)).iTOW == sat.iTOW == now.itow_ms


def test_nav_sig_lists_two_signals_of_each_satellite_and_uses_the_satellites_of_nav_sat() -> None:
    now = epoch(carrier="fixed")
    sig = parse_ubx(ubx_encoder.nav_sig(now))
    rows = range(1, sig.numSigs + 1)
    first, second = ([n for n in rows if n % 2 == parity] for parity in (1, 0))
    assert (sig.iTOW, sig.numSigs) == (now.itow_ms, 2 * len(now.sky.number))
    assert sum(getattr(sig, f"prUsed_{n:02d}") for n in first) == now.satellites_used
    signals = {(getattr(sig, f"gnssId_{n:02d}"), getattr(sig, f"sigId_{n:02d}")) for n in rows}
    assert signals == {(0, 0), (0, 3), (2, 0), (2, 6), (3, 0), (3, 2), (6, 0), (6, 2)}
    assert all(getattr(sig, f"cno_{n:02d}") <= getattr(sig, f"cno_{n - 1:02d}") for n in second)
    assert all(getattr(sig, f"crUsed_{n:02d}") == getattr(sig, f"prUsed_{n:02d}") for n in rows)


def test_the_calendar_time_of_an_epoch_has_its_milliseconds() -> None:
    assert epoch().utc == datetime(2026, 9, 21, 14, 13, 21, 200_000, tzinfo=UTC)


def test_rmc_and_gga_encode_the_fix() -> None:
    rmc = parse_nmea(nmea_encoder.rmc(epoch()))
    gga = parse_nmea(nmea_encoder.gga(epoch(carrier="fixed")))
    for sentence in (rmc, gga):
        assert sentence.latitude == pytest.approx(degrees(PLACE.latitude), abs=1e-7)
        assert sentence.longitude == pytest.approx(degrees(PLACE.longitude), abs=1e-7)
    assert rmc.status == "A"
    assert rmc.datetime == datetime(2026, 9, 21, 14, 13, 21, 200_000, tzinfo=UTC)
    assert float(rmc.spd_over_grnd) == pytest.approx(5.0 * 3600 / 1852, abs=1e-3)
    assert float(rmc.true_course) == pytest.approx(306.87, abs=0.01)
    assert gga.gps_qual == 4
    assert gga.altitude == pytest.approx(PLACE.height - GEOID_M, abs=0.05)
    assert float(gga.geo_sep) == GEOID_M
    assert gga.num_sats == "12"


def test_southern_and_western_positions_have_their_hemisphere_letters() -> None:
    rmc = parse_nmea(nmea_encoder.rmc(epoch(place=Geodetic(radians(-33.5), radians(-151.999999999), 0.0))))
    assert (rmc.lat, rmc.lat_dir) == ("3330.00000", "S")
    assert (rmc.lon, rmc.lon_dir) == ("15200.00000", "W")


def test_every_constellation_has_its_gsa_sentence() -> None:
    lines = nmea_encoder.gsa(epoch()).splitlines(keepends=True)
    parsed = [parse_nmea(line) for line in lines]
    assert [line.split(b",")[-1][:1] for line in lines] == [b"1", b"3", b"2", b"4"]
    assert all(sentence.mode_fix_type == "3" for sentence in parsed)
    assert float(parsed[0].hdop) == pytest.approx(epoch().sky.dop.horizontal, abs=0.005)
    assert 65 <= int(parsed[2].sv_id01) <= 88, "GLONASS counts from 65"


def test_sentences_without_a_fix_are_void() -> None:
    lost = epoch(valid=False)
    rmc, gga = (parse_nmea(encode(lost)) for encode in (nmea_encoder.rmc, nmea_encoder.gga))
    assert (rmc.status, rmc.lat, gga.gps_qual, gga.lat) == ("V", "", 0, "")
    assert parse_nmea(nmea_encoder.gsa(lost).splitlines()[0]).mode_fix_type == "1"


def responses(receiver: Settings, *messages: bytes) -> Iterator[Any]:
    for message in messages:
        for response in receiver.feed(message):
            yield parse_ubx(response)


def test_the_keys_are_those_of_the_interface_description() -> None:
    for name, key in receiver_settings.OUTPUTS.items():
        ports = [
            UBX_CONFIG_DATABASE[f"CFG_MSGOUT_{name}_{port}"][0] for port in ("I2C", "UART1", "UART2", "USB", "SPI")
        ]
        assert ports == [key + i for i in range(5)]
    assert UBX_CONFIG_DATABASE["CFG_RATE_MEAS"][0] == receiver_settings.RATE_MEAS
    assert UBX_CONFIG_DATABASE["CFG_RATE_NAV"][0] == receiver_settings.RATE_NAV
    assert UBX_CONFIG_DATABASE["CFG_RATE_TIMEREF"][0] == receiver_settings.RATE_TIMEREF
    assert UBX_CONFIG_DATABASE["CFG_NAVSPG_DYNMODEL"][0] == receiver_settings.DYNAMIC_MODEL


def test_valset_is_acknowledged_applied_and_read_back() -> None:
    receiver = Settings(("ubx",))
    wanted = [("CFG_RATE_MEAS", 200), ("CFG_MSGOUT_UBX_NAV_SAT_UART1", 5), ("CFG_MSGOUT_UBX_NAV_SAT_USB", 5)]
    (acknowledged,) = responses(receiver, valset(wanted))
    assert (acknowledged.identity, acknowledged.clsID, acknowledged.msgID) == ("ACK-ACK", 0x06, 0x8A)
    assert receiver.period_ms == 200
    assert "UBX_NAV_SAT" in set(receiver.due(10))
    assert "UBX_NAV_SAT" not in set(receiver.due(11))
    poll = valget([name for name, _ in wanted])
    values, acknowledged = responses(receiver, poll)
    assert (values.CFG_RATE_MEAS, values.CFG_MSGOUT_UBX_NAV_SAT_UART1) == (200, 5)
    assert (acknowledged.identity, acknowledged.msgID) == ("ACK-ACK", 0x8B)
    defaults, _ = responses(receiver, valget(["CFG_RATE_MEAS"], layer=7))
    assert defaults.CFG_RATE_MEAS == 1000


@pytest.mark.parametrize("bad", [("CFG_RATE_MEAS", 10), ("CFG_UART1_BAUDRATE", 9600)])
def test_a_valset_with_one_invalid_value_is_rejected_as_a_whole(bad: tuple[str, int]) -> None:
    receiver = Settings(("ubx",))
    (rejected,) = responses(receiver, valset([("CFG_RATE_NAV", 2), bad]))
    assert (rejected.identity, rejected.msgID) == ("ACK-NAK", 0x8A)
    assert receiver.period_ms == 1000


def test_a_poll_of_an_unknown_key_is_rejected() -> None:
    (rejected,) = responses(Settings(("ubx",)), valget(["CFG_UART1_BAUDRATE"]))
    assert (rejected.identity, rejected.msgID) == ("ACK-NAK", 0x8B)


def test_the_receiver_reports_its_version() -> None:
    (version,) = responses(Settings(("ubx",)), ubx_frame(0x0A, 0x04, b""))
    assert version.hwVersion.startswith(b"00190000")
    assert b"MOD=ZED-F9P" in b"".join(getattr(version, f"extension_{i:02d}") for i in range(1, 6))


def test_commands_are_accepted_byte_by_byte_and_between_invalid_bytes() -> None:
    receiver = Settings(("ubx",))
    command = valset([("CFG_RATE_MEAS", 500)])
    broken = command[:-1] + bytes([command[-1] ^ 1])
    stream = b"\xb5\x62\x06\x8a\xff\xff" + b"garbage" + broken + command
    responded = [response for byte in stream for response in receiver.feed(bytes([byte]))]
    assert [parse_ubx(response).identity for response in responded] == ["ACK-ACK"]
    assert receiver.period_ms == 500


def test_the_buffer_is_bounded_under_invalid_bytes() -> None:
    receiver = Settings(("ubx",))
    for _ in range(100):
        assert not list(receiver.feed(b"\xb5\x62\x06\x8a\x00\x04" + bytes(5000)))
    assert len(pickle.dumps(receiver)) <= len(pickle.dumps(Settings(("ubx",)))) + 2 * MAX_PAYLOAD + 1000


@pytest.mark.parametrize(("protocols", "first"), [(("ubx",), "UBX"), (("nmea",), "NMEA")])
def test_a_receiver_starts_with_the_configured_protocols(protocols: tuple[str, ...], first: str) -> None:
    assert {name.split("_")[0] for name in Settings(protocols).due(0)} == {first}


def test_dilution_of_a_known_geometry() -> None:
    """Four satellites at the horizon and one at the zenith: H'H = diag(2, 2, 1, 5) with -1 between down and time."""
    elevation = np.radians([0.0, 0.0, 0.0, 0.0, 90.0])
    azimuth = np.radians([0.0, 90.0, 180.0, 270.0, 0.0])
    dop = dilution(elevation, azimuth)
    assert [dop.north, dop.east] == pytest.approx([sqrt(0.5), sqrt(0.5)])
    assert [dop.vertical, dop.time] == pytest.approx([sqrt(1.25), sqrt(0.25)])


def look(model: SkyModel, time_s: float, mask_deg: float, *, covered: bool = False) -> Sky:
    return model.at(time_s, PLACE, mask_deg=mask_deg, loss_db=0.0, covered=covered)


def test_satellites_move_slowly_and_an_elevation_mask_blocks_the_low_ones() -> None:
    now, later = (look(SKY, 1.79e9 + dt, 10.0) for dt in (0.0, 1.0))
    both = min(len(now.number), len(later.number))
    assert np.abs(now.elevation_deg[:both] - later.elevation_deg[:both]).max() < 0.02
    assert np.abs(now.cn0_db_hz - later.cn0_db_hz).max() < 1.5
    town = look(SKY, 1.79e9, 30.0)
    assert town.used.sum() < now.used.sum()
    assert town.dop.position > now.dop.position
    assert not look(SKY, 1.79e9, 10.0, covered=True).used.any()


def test_two_constellations_give_about_as_many_satellites_as_the_paper_reports() -> None:
    model = SkyModel(("gps", "galileo"), (1,))
    used = [int(look(model, 1.79e9 + 600.0 * i, 15.0).used.sum()) for i in range(144)]
    assert 9 <= np.median(used) <= 20
    assert min(used) >= 6


def test_orbits_have_the_periods_of_their_systems() -> None:
    """Half a sidereal day for GPS: the constellation repeats after a sidereal day."""
    model = SkyModel(("gps",), (3,))
    now, a_day_later = look(model, 0.0, 10.0), look(model, 86_164.1, 10.0)
    assert set(now.number.tolist()) == set(a_day_later.number.tolist())
    assert now.elevation_deg == pytest.approx(a_day_later.elevation_deg, abs=1.0)
    assert set(CONSTELLATIONS) == set(NAMES)

"""The satellites of one epoch by GSV, which are in view, and by GSA, which are used.

Source: NMEA 0183 version 4.11, as described in u-blox F9 HPG 1.32 (UBX-22008968), sections 1.5.2, 2.7.6 and 2.7.9.
"""

from math import radians

from shared.messages.gnss import Constellation, GnssSatellites, Satellite

from .burst import NmeaEpoch, Sentence

MOST = 128
# Talkers of GSV and GSA, and the system of GSA of version 4.11, whose talker is GN.
TALKERS = {
    "GP": Constellation.GPS, "GL": Constellation.GLONASS, "GA": Constellation.GALILEO, "GB": Constellation.BEIDOU,
    "BD": Constellation.BEIDOU, "GQ": Constellation.QZSS, "QZ": Constellation.QZSS, "GI": Constellation.NAVIC,
}  # fmt: skip
SYSTEMS = {
    "1": Constellation.GPS, "2": Constellation.GLONASS, "3": Constellation.GALILEO, "4": Constellation.BEIDOU,
    "5": Constellation.QZSS, "6": Constellation.NAVIC,
}  # fmt: skip
GSA_SATELLITES = slice(2, 14)
GSV_HEAD, GSV_SATELLITE = 3, 4  # fields before the satellites, and of each
Key = tuple[Constellation, int]


def satellites_of(epoch: NmeaEpoch, *, sampled_ns: int, source: str) -> GnssSatellites | None:
    """The satellites of an epoch, of several signals that of the best C/N0; None without GSV."""
    used = {key for gsa in epoch.all("GSA") for key in _used(gsa)}
    found: dict[Key, Satellite] = {}
    for gsv in epoch.all("GSV"):
        talker = TALKERS.get(gsv.talker, Constellation.UNKNOWN)
        for place in range(GSV_HEAD, len(gsv.data) - GSV_SATELLITE + 1, GSV_SATELLITE):
            number, elevation, azimuth, cn0 = (_integer(text) for text in gsv.data[place : place + GSV_SATELLITE])
            if number is None:
                continue
            key = _key(talker, number)
            located = elevation is not None and azimuth is not None and abs(elevation) <= 90 and 0 <= azimuth <= 360
            satellite = Satellite(
                constellation=key[0], number=key[1], cn0_db_hz=None if cn0 is None else float(cn0), used=key in used,
                elevation_rad=radians(elevation) if located and elevation is not None else None,
                azimuth_rad=radians(azimuth) if located and azimuth is not None else None,
            )  # fmt: skip
            if key not in found or (satellite.cn0_db_hz or 0.0) > (found[key].cn0_db_hz or 0.0):
                found[key] = satellite
    if not found:
        return None
    return GnssSatellites(
        sampled_ns=sampled_ns, received_ns=epoch.last_received_ns, source=source,
        satellites=tuple(found.values())[:MOST],
    )  # fmt: skip


def _used(gsa: Sentence) -> list[Key]:
    system = SYSTEMS.get(gsa.data[17]) if len(gsa.data) > 17 else None
    constellation = system or TALKERS.get(gsa.talker, Constellation.GPS)
    numbers = (_integer(text) for text in gsa.data[GSA_SATELLITES])
    return [_key(constellation, number) for number in numbers if number is not None]


def _key(constellation: Constellation, number: int) -> Key:
    """Constellation and number in it: NMEA numbers SBAS from 33, GLONASS from 65, QZSS from 193."""
    if constellation in (Constellation.GPS, Constellation.UNKNOWN) and 33 <= number <= 64:
        return Constellation.SBAS, number + 87
    if 65 <= number <= 96 and constellation in (Constellation.GPS, Constellation.GLONASS, Constellation.UNKNOWN):
        return Constellation.GLONASS, number - 64
    if 193 <= number <= 202:
        return Constellation.QZSS, number - 192
    return constellation, number


def _integer(text: str) -> int | None:
    return int(text) if text.isascii() and text.isdigit() and len(text) <= 3 else None

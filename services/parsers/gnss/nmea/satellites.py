"""The satellites of one epoch by GSV, which are in view, and by GSA, which are used.

Source: NMEA 0183 version 4.11, as described in u-blox F9 HPG 1.32 (UBX-22008968), sections 1.5.2, 2.7.6 and 2.7.9, and
"Satellite numbering" of u-blox M8 (UBX-13003221), appendix A, for the extended numbers of version 4.0 and before.
"""

from math import radians

from shared.messages.gnss import Constellation, GnssSatellites, Satellite

from .burst import NmeaEpoch, Sentence

MAX_SATELLITES = 128
# Talkers of GSV and GSA, and the system of GSA of version 4.11, whose talker is GN.
TALKERS = {
    "GP": Constellation.GPS, "GL": Constellation.GLONASS, "GA": Constellation.GALILEO, "GB": Constellation.BEIDOU,
    "BD": Constellation.BEIDOU, "GQ": Constellation.QZSS, "QZ": Constellation.QZSS, "GI": Constellation.NAVIC,
}  # fmt: skip
SYSTEMS = {
    "1": Constellation.GPS, "2": Constellation.GLONASS, "3": Constellation.GALILEO, "4": Constellation.BEIDOU,
    "5": Constellation.QZSS, "6": Constellation.NAVIC,
}  # fmt: skip
# Forms of numbering by talker: system, first and last number, and the number of the first one in the system. Before
# version 4.11 the talker GP, and GN or an unknown one, have satellites of several systems; BeiDou has an offset of 100,
# 200 or 400 by maker, Galileo of 100 to 300.
_SBAS = ((Constellation.SBAS, 33, 64, 120), (Constellation.SBAS, 120, 158, 120))  # the number is the PRN
_GLONASS = (Constellation.GLONASS, 65, 96, 1)
_GALILEO = tuple((Constellation.GALILEO, first, first + 35, 1) for first in (1, 101, 201, 301))
_BEIDOU = tuple((Constellation.BEIDOU, first, first + 62, 1) for first in (1, 101, 201, 401))
FORMS = {
    Constellation.GPS: ((Constellation.GPS, 1, 32, 1), *_SBAS, _GLONASS, (Constellation.QZSS, 193, 202, 1)),
    Constellation.GLONASS: (_GLONASS, _SBAS[0]),
    Constellation.GALILEO: _GALILEO,
    Constellation.BEIDOU: _BEIDOU,
    Constellation.QZSS: (
        (Constellation.QZSS, 1, 10, 1), (Constellation.QZSS, 183, 192, 1), (Constellation.QZSS, 193, 202, 1),
    ),
    Constellation.NAVIC: ((Constellation.NAVIC, 1, 14, 1), (Constellation.NAVIC, 901, 914, 1)),
    Constellation.UNKNOWN: (
        (Constellation.GPS, 1, 32, 1), *_SBAS, _GLONASS, (Constellation.QZSS, 193, 200, 1), _BEIDOU[2], _GALILEO[3],
        _BEIDOU[3],
    ),
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
        satellites=tuple(found.values())[:MAX_SATELLITES],
    )  # fmt: skip


def _used(gsa: Sentence) -> list[Key]:
    system = SYSTEMS.get(gsa.data[17]) if len(gsa.data) > 17 else None
    constellation = system or TALKERS.get(gsa.talker, Constellation.UNKNOWN)
    numbers = (_integer(text) for text in gsa.data[GSA_SATELLITES])
    return [_key(constellation, number) for number in numbers if number is not None]


def _key(constellation: Constellation, number: int) -> Key:
    """Constellation and number in it; the number as it is where no form of numbering is known."""
    for system, first, last, lowest in FORMS[constellation]:
        if first <= number <= last:
            return system, number - first + lowest
    return constellation, number


def _integer(text: str) -> int | None:
    return int(text) if text.isascii() and text.isdigit() and len(text) <= 3 else None

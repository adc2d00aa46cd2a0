"""RTCM 3 messages: ephemerides (1019, 1046) and raw measurements of GPS L1 C/A and Galileo E1 (MSM5).

1046 is Galileo's I/NAV, whose clock and group delay are those of E1 with E5b; 1045 (F/NAV) is for E1 with E5a.

References
----------
RTCM 10403.3, tables 3.5-21, 3.5-102, 3.5-78, 3.5-82 and 3.5-87.
"""

from collections.abc import Iterable, Iterator
from typing import Any

from services.core.cooperative.broadcast.ephemeris import Ephemeris
from services.core.cooperative.broadcast.galileo_inav import NO_ACCURACY, accuracy_m
from services.core.cooperative.broadcast.gps_lnav import URA_M, nearest_ns
from services.core.cooperative.measurements import Constellation, Measurement, RawEpoch, SatelliteId
from shared.maths.gnss_signals import L1_FREQUENCY, SPEED_OF_LIGHT
from shared.maths.navigation_words import GPS_PI

MS_NS = 1_000_000
LIGHT_MS_M = SPEED_OF_LIGHT * 1e-3  # [m] in a millisecond
EPHEMERIDES = {"1019": Constellation.GPS, "1046": Constellation.GALILEO}
MEASUREMENTS = {"1075": (Constellation.GPS, "DF004"), "1095": (Constellation.GALILEO, "DF248")}
SIGNAL = "1C"
NO_RANGE_MS, NO_FINE_RANGE_MS = 255, -(2.0**-10)
NO_RATE, NO_FINE_RATE = -8192, -1.6384  # [m/s]
# Data fields of 1019 and 1046
ORBIT = {
    "sqrt_a": ("DF092", "DF303"), "eccentricity": ("DF090", "DF301"), "cuc": ("DF089", "DF300"),
    "cus": ("DF091", "DF302"), "crc": ("DF098", "DF309"), "crs": ("DF086", "DF297"), "cic": ("DF094", "DF305"),
    "cis": ("DF096", "DF307"),
}  # fmt: skip
ANGLES = {  # in semicircles
    "mean_anomaly": ("DF088", "DF299"), "mean_motion_difference": ("DF087", "DF298"), "node": ("DF095", "DF306"),
    "node_rate": ("DF100", "DF311"), "inclination": ("DF097", "DF308"), "inclination_rate": ("DF079", "DF292"),
    "perigee": ("DF099", "DF310"),
}  # fmt: skip


def read_rtcm(messages: Iterable[Any], near_ns: int) -> tuple[list[Ephemeris], list[RawEpoch]]:
    """Read all ephemerides and raw epochs of a log.

    Parameters
    ----------
    messages : iterable of pyrtcm.RTCMMessage
        In the order of the log; others are passed over.
    near_ns : int
        [ns] GPS time within half a week of the log: measurements carry the time of week alone.

    Returns
    -------
    list of Ephemeris, list of RawEpoch
        In the order of the log; GPS and Galileo of one time are one epoch. Of several signals of a satellite on 1575.42
        MHz only the C/A code and E1-C are read.
    """
    ephemerides: list[Ephemeris] = []
    epochs: dict[int, list[Measurement]] = {}
    for message in messages:
        kind = getattr(message, "identity", None)
        if kind in EPHEMERIDES:
            ephemerides.append(_gps(message, near_ns) if kind == "1019" else _galileo(message, near_ns))
        elif kind in MEASUREMENTS:
            constellation, time = MEASUREMENTS[kind]
            seconds, milliseconds = divmod(getattr(message, time), 1000)
            time_ns = nearest_ns(seconds, near_ns) + milliseconds * MS_NS
            epochs.setdefault(time_ns, []).extend(measurements_of(message, constellation))
    return ephemerides, [RawEpoch(time_ns, tuple(measured)) for time_ns, measured in epochs.items()]


def measurements_of(message: Any, constellation: Constellation) -> Iterator[Measurement]:
    """Pseudorange c (N + rough + fine) and range-rate rough + fine of each satellite's signal on L1 or E1."""
    rough = {
        getattr(message, f"PRN_{k:02d}"): tuple(getattr(message, f"DF{field}_{k:02d}") for field in (397, 398, 399))
        for k in range(1, message.NSat + 1)
    }
    for k in range(1, message.NCell + 1):
        number, signal = getattr(message, f"CELLPRN_{k:02d}"), getattr(message, f"CELLSIG_{k:02d}")
        whole_ms, part_ms, whole_rate = rough[number]
        fine_ms, cn0, fine_rate = (getattr(message, f"DF{field}_{k:02d}") for field in (400, 403, 404))
        if signal != SIGNAL or whole_ms == NO_RANGE_MS or fine_ms <= NO_FINE_RANGE_MS:
            continue
        known = whole_rate != NO_RATE and fine_rate > NO_FINE_RATE
        doppler = -(whole_rate + fine_rate) * L1_FREQUENCY / SPEED_OF_LIGHT if known else None
        satellite = SatelliteId(constellation, int(number))
        yield Measurement(satellite, LIGHT_MS_M * (whole_ms + part_ms + fine_ms), doppler, float(cn0) or None)


def _orbit(message: Any, column: int) -> dict[str, Any]:
    """Give the orbit's parameters by their names in `Ephemeris`."""
    angles = {name: getattr(message, field[column]) * GPS_PI for name, field in ANGLES.items()}
    return {name: float(getattr(message, field[column])) for name, field in ORBIT.items()} | angles


def _gps(message: Any, near_ns: int) -> Ephemeris:
    accuracy = URA_M[message.DF077] if len(URA_M) > message.DF077 else None
    toe_ns, toc_ns = (nearest_ns(seconds, near_ns) for seconds in (message.DF093, message.DF081))
    clock = (message.DF084, message.DF083, message.DF082)
    return Ephemeris(
        SatelliteId(Constellation.GPS, message.DF009), message.DF071, toe_ns, toc_ns, **_orbit(message, 0),
        clock=clock, group_delay_s=message.DF101, healthy=message.DF102 == 0 and accuracy is not None,
        accuracy_m=accuracy,
    )  # fmt: skip


def _galileo(message: Any, near_ns: int) -> Ephemeris:
    toe_ns, toc_ns = (nearest_ns(seconds, near_ns) for seconds in (message.DF304, message.DF293))
    clock = (message.DF296, message.DF295, message.DF294)
    return Ephemeris(
        SatelliteId(Constellation.GALILEO, message.DF252), message.DF290, toe_ns, toc_ns,
        **_orbit(message, 1), clock=clock, group_delay_s=message.DF313,
        healthy=message.DF287 == 0 and message.DF288 == 0 and message.DF286 != NO_ACCURACY,
        accuracy_m=accuracy_m(message.DF286),
    )  # fmt: skip

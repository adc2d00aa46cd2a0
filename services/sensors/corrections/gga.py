"""The position that a caster is told: NMEA GGA of the last fix, while the unit does not distrust it.

References
----------
NMEA 0183, sentence GGA; RTCM 10410.1 (NTRIP 2.0), section 2.5: GGA from the client to the caster.
"""

from functools import reduce
from operator import xor

from shared.messages.gnss import CarrierSolution, FixType, GnssFix
from shared.messages.trust import TrustLevel, TrustState

NS = 1_000_000_000
MAX_AGE_S = 10.0  # of a fix: at 30 m/s 300 m, which changes nothing in the corrections of a network
TRUST_S = 5.0  # after which a verdict has no meaning, as for the topic's own deadline
_LOCATED = (FixType.TWO_D, FixType.THREE_D, FixType.GNSS_DEAD_RECKONING)
_QUALITY = {CarrierSolution.FIXED: 4, CarrierSolution.FLOAT: 5}


class Position:
    """Keeps the newest fix and the newest verdict."""

    def __init__(self) -> None:
        self._fix: GnssFix | None = None
        self._trust: TrustState | None = None

    def note(self, message: GnssFix | TrustState) -> None:
        """Take over a fix with a position, or a verdict."""
        if isinstance(message, TrustState):
            self._trust = message
        elif message.fix_type in _LOCATED and message.latitude_deg is not None and message.longitude_deg is not None:
            self._fix = message

    def location(self, now_ns: int) -> tuple[float, float] | None:
        """Latitude and longitude in degrees; None without a fresh fix, or while the verdict is UNSAFE."""
        fix = self._usable(now_ns)
        return None if fix is None else (fix.latitude_deg or 0.0, fix.longitude_deg or 0.0)

    def gga(self, now_ns: int) -> str | None:
        """The sentence with its line end; None without a fresh fix, or while the verdict is UNSAFE."""
        fix = self._usable(now_ns)
        return None if fix is None else gga(fix)

    def _usable(self, now_ns: int) -> GnssFix | None:
        fix, trust = self._fix, self._trust
        if fix is None or not 0 <= now_ns - fix.received_ns <= MAX_AGE_S * NS:
            return None
        fresh = trust is not None and 0 <= now_ns - trust.sampled_ns <= TRUST_S * NS
        return None if fresh and trust is not None and trust.state is TrustLevel.UNSAFE else fix


def gga(fix: GnssFix) -> str:
    """Write a fix as GGA with checksum and line end; heights are 0 where the receiver states none."""
    seconds = 0.0 if fix.utc_ns is None else fix.utc_ns % (86400 * NS) // 10_000_000 / 100
    hours, rest = divmod(seconds, 3600.0)
    minutes, seconds = divmod(rest, 60.0)
    separation = 0.0
    if fix.height_ellipsoid_m is not None and fix.height_msl_m is not None:
        separation = fix.height_ellipsoid_m - fix.height_msl_m
    quality = _QUALITY.get(fix.carrier_solution, 2 if fix.differential else 1)
    body = (
        f"GPGGA,{hours:02.0f}{minutes:02.0f}{seconds:05.2f},{_angle(fix.latitude_deg or 0.0, 2, 'NS')},"
        f"{_angle(fix.longitude_deg or 0.0, 3, 'EW')},{quality},{min(fix.satellites_used or 0, 99):02d},"
        f"{min(fix.hdop or 1.0, 99.9):.1f},{fix.height_msl_m or 0.0:.2f},M,{separation:.2f},M,,"
    )
    return f"${body}*{reduce(xor, body.encode(), 0):02X}\r\n"


def _angle(angle_deg: float, digits: int, letters: str) -> str:
    """Write degrees and minutes; 1e-5 minutes are 2 cm."""
    units = round(abs(angle_deg) * 60 * 100_000)  # rounded first, so that minutes never become 60
    degrees, rest = divmod(units, 60 * 100_000)
    return f"{degrees:0{digits}d}{rest / 100_000:08.5f},{letters[angle_deg < 0]}"

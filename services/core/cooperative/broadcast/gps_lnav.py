"""GPS LNAV subframes, as u-blox's RXM-SFRBX carries them: ten 32-bit words a subframe.

Each word holds 24 data bits and 6 parity bits in its lowest 30 bits. The receiver has already undone the complement
that D30* makes of data and parity, and what it writes into the two highest bits differs between generations: parity
is therefore accepted for either value of D29* and D30*.

References
----------
IS-GPS-200N, 20.3.3 and tables 20-I to 20-XIV; u-blox F9 HPG 1.32 interface description (UBX-22008968), 1.4.
"""

from dataclasses import dataclass

from shared.maths.gnss_signals import Klobuchar
from shared.maths.navigation_words import GPS_PI, parity

from ..measurements import SECONDS_PER_WEEK, WEEK_NS, Constellation, SatelliteId
from .bits import Bits, joined
from .ephemeris import Ephemeris

WORDS = 10
PREAMBLE = 0x8B
IONOSPHERE_PAGE = 56  # SV ID of subframe 4, page 18
URA_M = (2.4, 3.4, 4.85, 6.85, 9.65, 13.65, 24.0, 48.0, 96.0, 192.0, 384.0, 768.0, 1536.0, 3072.0, 6144.0)
ROLLOVER_WEEKS = 1024


@dataclass(frozen=True)
class Subframe:
    """A subframe whose parity holds: its number, the time of week at which the next one begins, and 192 data bits."""

    number: int
    next_tow_s: int
    data: int

    def bits(self) -> Bits:
        """Words 3 to 10 without parity."""
        return Bits(self.data, 192)


PARITY_OF_STARS = frozenset(parity(stars << 30) for stars in range(4))


def decode_subframe(words: tuple[int, ...]) -> Subframe | None:
    """Decode the words of one RXM-SFRBX; None where length, preamble or parity is wrong."""
    if len(words) != WORDS:
        return None
    if any((parity(word & 0x3FFFFFFF) ^ word & 0x3F) not in PARITY_OF_STARS for word in words):
        return None
    data = joined(tuple(word >> 6 for word in words), 24)
    head = Bits(data >> 192, 48)
    if head.unsigned(8) != PREAMBLE:
        return None
    head.skip(16)
    next_tow_s = 6 * head.unsigned(17)
    head.skip(2)
    number = head.unsigned(3)
    if not 1 <= number <= 5 or next_tow_s >= SECONDS_PER_WEEK:
        return None
    return Subframe(number, next_tow_s, data & ((1 << 192) - 1))


def decode_ephemeris(number: int, subframes: tuple[Subframe, Subframe, Subframe], gps_time_ns: int) -> Ephemeris | None:
    """Decode an ephemeris from subframes 1, 2 and 3 of a satellite.

    Parameters
    ----------
    number : int
        PRN.
    subframes : tuple of Subframe
        In the order 1, 2, 3.
    gps_time_ns : int
        [ns] Time of reception; resolves the week's roll-over of 1024 weeks.

    Returns
    -------
    Ephemeris or None
        None where the three belong to different issues of data.
    """
    first, second, third = (subframe.bits() for subframe in subframes)
    week = first.unsigned(10)
    first.skip(2)
    ura, health, iodc_high = first.unsigned(4), first.unsigned(6), first.unsigned(2)
    first.skip(88)
    group_delay = first.signed(8) * 2.0**-31
    iodc, toc = iodc_high << 8 | first.unsigned(8), 16 * first.unsigned(16)
    af2, af1, af0 = first.signed(8) * 2.0**-55, first.signed(16) * 2.0**-43, first.signed(22) * 2.0**-31

    iode, crs = second.unsigned(8), second.signed(16) * 2.0**-5
    mean_motion_difference, mean_anomaly = _angle(second, 16, 43), _angle(second, 32, 31)
    cuc, eccentricity = second.signed(16) * 2.0**-29, second.unsigned(32) * 2.0**-33
    cus, sqrt_a, toe = second.signed(16) * 2.0**-29, second.unsigned(32) * 2.0**-19, 16 * second.unsigned(16)

    cic, node = third.signed(16) * 2.0**-29, _angle(third, 32, 31)
    cis, inclination = third.signed(16) * 2.0**-29, _angle(third, 32, 31)
    crc, perigee = third.signed(16) * 2.0**-5, _angle(third, 32, 31)
    node_rate = _angle(third, 24, 43)
    iode_third, inclination_rate = third.unsigned(8), _angle(third, 14, 43)

    if not iode == iode_third == iodc & 0xFF or max(toe, toc) >= SECONDS_PER_WEEK:
        return None
    sent_ns = resolved_week(week, gps_time_ns) * WEEK_NS + subframes[0].next_tow_s * 1_000_000_000
    return Ephemeris(
        SatelliteId(Constellation.GPS, number), iode, nearest_ns(toe, sent_ns), nearest_ns(toc, sent_ns),
        sqrt_a, eccentricity, mean_anomaly, mean_motion_difference, node, node_rate, inclination, inclination_rate,
        perigee, cuc, cus, crc, crs, cic, cis, (af0, af1, af2), group_delay,
        healthy=health == 0 and ura < len(URA_M), accuracy_m=URA_M[ura] if ura < len(URA_M) else None,
    )  # fmt: skip


def decode_ionosphere(subframe: Subframe) -> Klobuchar | None:
    """Read the ionosphere's coefficients from page 18 of subframe 4; None from any other page."""
    bits = subframe.bits()
    bits.skip(2)
    if subframe.number != 4 or bits.unsigned(6) != IONOSPHERE_PAGE:
        return None
    a0, a1, a2, a3, b0, b1, b2, b3 = (
        bits.signed(8) * 2.0**power for power in (-30, -27, -24, -24, 11, 14, 16, 16)
    )  # fmt: skip
    return Klobuchar((a0, a1, a2, a3), (b0, b1, b2, b3))


def resolved_week(week: int, gps_time_ns: int, modulus: int = ROLLOVER_WEEKS) -> int:
    """Full week number nearest to an instant, of a week that was broadcast modulo some number of weeks."""
    now = gps_time_ns // WEEK_NS
    half = modulus // 2
    return now + (week - now + half) % modulus - half


def nearest_ns(seconds_of_week: int, reference_ns: int) -> int:
    """GPS time [ns] of a time of week within half a week of a reference: right across the end of the week."""
    time_ns = seconds_of_week * 1_000_000_000
    half = WEEK_NS // 2
    return reference_ns + (time_ns - reference_ns + half) % WEEK_NS - half


def _angle(bits: Bits, length: int, power: int) -> float:
    """A signed field in semicircles, or semicircles per second, as radians."""
    return bits.signed(length) * 2.0**-power * GPS_PI

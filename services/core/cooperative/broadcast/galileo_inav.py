"""Galileo I/NAV pages of E1-B, as u-blox's RXM-SFRBX carries them: eight 32-bit words, even part before odd part.

References
----------
Galileo OS SIS ICD 2.1, 4.3.2 (pages, CRC), 4.3.5 (words 1 to 5), 5.1.9 (data validity);
u-blox F9 HPG 1.32 interface description (UBX-22008968), 1.4.
"""

from collections.abc import Mapping
from dataclasses import dataclass

from shared.maths.navigation_words import GPS_PI, crc24q

from ..measurements import SECONDS_PER_WEEK, WEEK_NS, Constellation, SatelliteId
from .bits import Bits, joined
from .ephemeris import Ephemeris
from .gps_lnav import nearest_ns, resolved_week

WORDS = 8
EPHEMERIS_WORDS = (1, 2, 3, 4, 5)
GST_WEEK_OF_GPS = 1024  # Galileo's week 0 began at this GPS week, whose roll-overs it does not share
ROLLOVER_WEEKS = 4096
NO_ACCURACY = 255


@dataclass(frozen=True)
class NavigationWord:
    """An I/NAV word whose CRC holds: its type and its 128 bits."""

    number: int
    data: int

    def bits(self) -> Bits:
        """The word behind its type."""
        return Bits(self.data & ((1 << 122) - 1), 122)


def decode_page(words: tuple[int, ...]) -> NavigationWord | None:
    """Decode one nominal page; None where its length, its parts' flags or its CRC is wrong, or it is an alert page."""
    if len(words) != WORDS:
        return None
    even, odd = joined(words[:4], 32), joined(words[4:], 32)
    # Each part begins with even/odd and page type: 0 0 and 1 0.
    if even >> 126 != 0b00 or odd >> 126 != 0b10:
        return None
    checked = (even >> 14) << 82 | odd >> 46  # 114 bits of the even part without its tail, 82 of the odd part
    if crc24q(checked, 196) != odd >> 22 & 0xFFFFFF:
        return None
    data = (even >> 14 & (1 << 112) - 1) << 16 | odd >> 110 & 0xFFFF
    return NavigationWord(data >> 122, data)


def decode_ephemeris(number: int, words: Mapping[int, NavigationWord], gps_time_ns: int) -> Ephemeris | None:
    """Decode an ephemeris from words 1 to 5 of a satellite.

    Parameters
    ----------
    number : int
        SVID.
    words : mapping of int to NavigationWord
        By type; 1 to 5 are needed.
    gps_time_ns : int
        [ns] Time of reception; resolves the week.

    Returns
    -------
    Ephemeris or None
        None where words 1 to 4 belong to different issues of data, or word 4 to another satellite.
    """
    one, two, three, four, five = (words[kind].bits() for kind in EPHEMERIS_WORDS)
    issues = {bits.unsigned(10) for bits in (one, two, three, four)}
    toe, mean_anomaly = 60 * one.unsigned(14), _angle(one, 32, 31)
    eccentricity, sqrt_a = one.unsigned(32) * 2.0**-33, one.unsigned(32) * 2.0**-19
    node, inclination, perigee = _angle(two, 32, 31), _angle(two, 32, 31), _angle(two, 32, 31)
    inclination_rate = _angle(two, 14, 43)
    node_rate, mean_motion_difference = _angle(three, 24, 43), _angle(three, 16, 43)
    cuc, cus = three.signed(16) * 2.0**-29, three.signed(16) * 2.0**-29
    crc, crs = three.signed(16) * 2.0**-5, three.signed(16) * 2.0**-5
    accuracy = three.unsigned(8)
    svid, cic, cis = four.unsigned(6), four.signed(16) * 2.0**-29, four.signed(16) * 2.0**-29
    toc = 60 * four.unsigned(14)
    af0, af1, af2 = four.signed(31) * 2.0**-34, four.signed(21) * 2.0**-46, four.signed(6) * 2.0**-59
    five.skip(11 + 11 + 14 + 5 + 10)  # ionosphere of NeQuick G, and BGD E1-E5a
    group_delay = five.signed(10) * 2.0**-32
    five.skip(2)
    e1_health = five.unsigned(2)
    five.skip(1)
    e1_invalid = five.unsigned(1)
    week, tow = five.unsigned(12), five.unsigned(20)

    if len(issues) != 1 or svid != number or max(toe, toc, tow) >= SECONDS_PER_WEEK:
        return None
    now = gps_time_ns - GST_WEEK_OF_GPS * WEEK_NS
    sent_ns = (resolved_week(week, now, ROLLOVER_WEEKS) + GST_WEEK_OF_GPS) * WEEK_NS + tow * 1_000_000_000
    return Ephemeris(
        SatelliteId(Constellation.GALILEO, number), issues.pop(), nearest_ns(toe, sent_ns), nearest_ns(toc, sent_ns),
        sqrt_a, eccentricity, mean_anomaly, mean_motion_difference, node, node_rate, inclination, inclination_rate,
        perigee, cuc, cus, crc, crs, cic, cis, (af0, af1, af2), group_delay,
        healthy=e1_health == 0 and e1_invalid == 0 and accuracy != NO_ACCURACY, accuracy_m=accuracy_m(accuracy),
    )  # fmt: skip


def accuracy_m(index: int) -> float | None:
    """Signal-in-space accuracy [m] of its index: Galileo OS SIS ICD 2.1, table 88."""
    for first, start, step in ((100, 2.0, 0.16), (75, 1.0, 0.04), (50, 0.5, 0.02), (0, 0.0, 0.01)):
        if index >= first:
            return start + (index - first) * step if index <= 125 else None
    return None


def _angle(bits: Bits, length: int, power: int) -> float:
    return bits.signed(length) * 2.0**-power * GPS_PI

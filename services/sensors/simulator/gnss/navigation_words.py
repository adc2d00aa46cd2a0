"""Navigation messages as satellites broadcast them: GPS LNAV subframes and Galileo I/NAV pages.

References
----------
IS-GPS-200N, 20.3.3; Galileo OS SIS ICD 2.1, 4.3.
"""

from dataclasses import dataclass

from shared.maths.gnss_signals import Klobuchar
from shared.maths.navigation_words import GPS_PI, crc24q, parity

Words = tuple[int, ...]
NS = 1_000_000_000
WEEK_S = 604_800
GALILEO_WEEK_0 = 1024  # in GPS weeks
SUBFRAME_S, PAGE_S = 6, 2
SUBFRAMES, ALMANAC_PAGES = 5, 25
IONOSPHERE_PAGE, IONOSPHERE_ID = 18, 56  # page of subframe 4 and the ID that names it
# Types of the words in the pages of E1-B, which repeat every 30 s: figure 34; 0 is spare, as are 6 to 10 here.
PAGE_WORDS = (2, 4, 0, 0, 0, 0, 0, 0, 0, 0, 1, 3, 5, 0, 0)


@dataclass(frozen=True)
class Elements:
    """Broadcast orbit and clock of a satellite: angles [rad], lengths [m], times [s] and GPS time [ns]."""

    number: int
    issue: int
    toe_ns: int
    toc_ns: int
    sqrt_a: float
    mean_anomaly: float
    node: float  # longitude of the ascending node at the start of the week
    inclination: float
    clock: tuple[float, float, float]
    group_delay_s: float
    eccentricity: float = 0.0
    perigee: float = 0.0
    mean_motion_difference: float = 0.0
    node_rate: float = 0.0
    inclination_rate: float = 0.0
    cuc: float = 0.0
    cus: float = 0.0
    crc: float = 0.0
    crs: float = 0.0
    cic: float = 0.0
    cis: float = 0.0
    healthy: bool = True


class Packer:
    """Concatenates fields, the most significant bit first."""

    def __init__(self) -> None:
        self.text = ""

    def put(self, value: int, bits: int) -> "Packer":
        """Append the lowest bits of an integer, negative ones in two's complement."""
        self.text += format(value & ((1 << bits) - 1), f"0{bits}b")
        return self

    def scaled(self, value: float, bits: int, power: int, unit: float = 1.0) -> "Packer":
        """Append a value in units of 2^-power."""
        return self.put(round(value / unit * 2.0**power), bits)


def lnav_words(data: str) -> Words:
    """240 data bits as ten words with parity, as they are after the complement by D30* was undone."""
    words = []
    for k in range(0, 240, 24):
        word = int(data[k : k + 24], 2) << 6
        words.append(word | parity(word))
    return tuple(words)


def lnav_subframe(one: Elements, number: int, next_s: int, ionosphere: Klobuchar | None = None) -> Words:
    """Encode a subframe of LNAV.

    Parameters
    ----------
    one : Elements
        Of the satellite.
    number : int
        1 to 3: clock and orbit; 4: the ionosphere's page, or without coefficients a page without content; 5: the same.
    next_s : int
        [s, GPS time] At which the next subframe begins, a multiple of 6.
    ionosphere : Klobuchar, optional
        Coefficients, for subframe 4.

    Returns
    -------
    tuple of int
        Ten words.
    """
    week, tow_s = divmod(next_s, WEEK_S)
    toe, toc = (time_ns // NS % WEEK_S // 16 for time_ns in (one.toe_ns, one.toc_ns))
    packer = Packer().put(0x8B, 8).put(0, 16).put(tow_s // SUBFRAME_S, 17).put(0, 2).put(number, 3).put(0, 2)
    if number == 1:
        packer.put(week, 10).put(1, 2).put(0, 4).put(0 if one.healthy else 63, 6).put(one.issue >> 8, 2).put(0, 88)
        packer.scaled(one.group_delay_s, 8, 31).put(one.issue, 8).put(toc, 16).scaled(one.clock[2], 8, 55)
        packer.scaled(one.clock[1], 16, 43).scaled(one.clock[0], 22, 31).put(0, 2)
    elif number == 2:
        packer.put(one.issue, 8).scaled(one.crs, 16, 5).scaled(one.mean_motion_difference, 16, 43, GPS_PI)
        packer.scaled(one.mean_anomaly, 32, 31, GPS_PI).scaled(one.cuc, 16, 29).scaled(one.eccentricity, 32, 33)
        packer.scaled(one.cus, 16, 29).scaled(one.sqrt_a, 32, 19).put(toe, 16).put(0, 8)
    elif number == 3:
        packer.scaled(one.cic, 16, 29).scaled(one.node, 32, 31, GPS_PI).scaled(one.cis, 16, 29)
        packer.scaled(one.inclination, 32, 31, GPS_PI).scaled(one.crc, 16, 5).scaled(one.perigee, 32, 31, GPS_PI)
        packer.scaled(one.node_rate, 24, 43, GPS_PI).put(one.issue, 8)
        packer.scaled(one.inclination_rate, 14, 43, GPS_PI).put(0, 2)
    else:
        packer.put(1, 2)
        if ionosphere is not None:
            packer.put(IONOSPHERE_ID, 6)
            for value, power in zip(
                ionosphere.alpha + ionosphere.beta, (30, 27, 24, 24, -11, -14, -16, -16), strict=True
            ):
                packer.scaled(value, 8, power)
    return lnav_words(packer.text.ljust(240, "0"))


def inav_page(one: Elements, kind: int, sent_s: int) -> Words:
    """Encode an I/NAV page.

    Parameters
    ----------
    one : Elements
        Of the satellite.
    kind : int
        Type of the word: 1 to 5; any other has no content.
    sent_s : int
        [s, GPS time] At which the page begins.

    Returns
    -------
    tuple of int
        Eight words.
    """
    week, tow_s = divmod(sent_s - GALILEO_WEEK_0 * WEEK_S, WEEK_S)
    toe, toc = (time_ns // NS % WEEK_S // 60 for time_ns in (one.toe_ns, one.toc_ns))
    packer = Packer().put(kind, 6)
    if 1 <= kind <= 4:
        packer.put(one.issue, 10)
    if kind == 1:
        packer.put(toe, 14).scaled(one.mean_anomaly, 32, 31, GPS_PI).scaled(one.eccentricity, 32, 33)
        packer.scaled(one.sqrt_a, 32, 19)
    elif kind == 2:
        packer.scaled(one.node, 32, 31, GPS_PI).scaled(one.inclination, 32, 31, GPS_PI)
        packer.scaled(one.perigee, 32, 31, GPS_PI).scaled(one.inclination_rate, 14, 43, GPS_PI)
    elif kind == 3:
        packer.scaled(one.node_rate, 24, 43, GPS_PI).scaled(one.mean_motion_difference, 16, 43, GPS_PI)
        packer.scaled(one.cuc, 16, 29).scaled(one.cus, 16, 29).scaled(one.crc, 16, 5).scaled(one.crs, 16, 5)
        packer.put(107, 8)  # signal-in-space accuracy: 3.12 m
    elif kind == 4:
        packer.put(one.number, 6).scaled(one.cic, 16, 29).scaled(one.cis, 16, 29).put(toc, 14)
        packer.scaled(one.clock[0], 31, 34).scaled(one.clock[1], 21, 46).scaled(one.clock[2], 6, 59)
    elif kind == 5:
        packer.put(0, 11 + 11 + 14 + 5 + 10).scaled(one.group_delay_s, 10, 32).put(0, 2)
        packer.put(0 if one.healthy else 1, 2).put(0, 2).put(week, 12).put(tow_s, 20)
    return page_words(packer.text.ljust(128, "0"))


def page_words(word: str) -> Words:
    """128 bits of a word as the eight words of a page, even part and odd part, with CRC."""
    even = "00" + word[:112] + "000000"
    odd = "10" + word[112:] + "0" * 64
    crc = crc24q(int(even[:114] + odd, 2), 196)
    bits = even.ljust(128, "0") + (odd + format(crc, "024b")).ljust(128, "0")
    return tuple(int(bits[k : k + 32], 2) for k in range(0, 256, 32))


def gps_words(one: Elements, end_s: int, ionosphere: Klobuchar) -> Words | None:
    """Words of the subframe that ends at a GPS time [s]; None where none does. Page 18 returns every 12.5 minutes."""
    if end_s % SUBFRAME_S:
        return None
    number = (end_s // SUBFRAME_S - 1) % SUBFRAMES + 1
    page = (end_s - SUBFRAME_S) // (SUBFRAMES * SUBFRAME_S) % ALMANAC_PAGES + 1
    sent = ionosphere if number == SUBFRAMES - 1 and page == IONOSPHERE_PAGE else None
    return lnav_subframe(one, number, end_s, sent)


def galileo_words(one: Elements, end_s: int) -> Words | None:
    """Words of the page that ends at a GPS time [s]; None where none does."""
    if end_s % PAGE_S:
        return None
    begin_s = end_s - PAGE_S
    return inav_page(one, PAGE_WORDS[begin_s // PAGE_S % len(PAGE_WORDS)], begin_s)

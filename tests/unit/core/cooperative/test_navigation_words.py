"""GPS LNAV subframes and Galileo I/NAV pages: what is encoded comes back, and what is damaged is refused."""

from dataclasses import replace

import pytest

from services.core.cooperative.broadcast import galileo_inav, gps_lnav
from services.core.cooperative.broadcast.ephemeris import Ephemeris
from services.core.cooperative.broadcast.store import EphemerisStore
from services.core.cooperative.measurements import WEEK_NS, Constellation, SatelliteId
from services.sensors.simulator.gnss.navigation_words import Packer, lnav_words
from shared.maths.navigation_words import parity
from tests.support.cases import each
from tests.support.gnss.constellation import (
    IONOSPHERE,
    NOW_NS,
    TOE_NS,
    constellation,
    ephemeris,
    inav_pages,
    lnav_subframes,
)

GPS, GALILEO = SatelliteId(Constellation.GPS, 7), SatelliteId(Constellation.GALILEO, 24)
# Subframe 5 of PRN 5 as a u-blox receiver reported it: preamble, parity with complemented words, bits 30 and 31.
RECEIVED = (
    0x22C0502E, 0x92D16C80, 0x1789BCED, 0x98FF4950, 0x3F50000F,
    0x284308F0, 0x24BD152A, 0xA35BC727, 0x2DC7C349, 0xB57FF4E0,
)  # fmt: skip


def assert_equal(found: Ephemeris, sent: Ephemeris) -> None:
    """Equal but for the resolution of each field."""
    assert (found.satellite, found.issue, found.toe_ns, found.toc_ns) == (
        sent.satellite, sent.issue, sent.toe_ns, sent.toc_ns,
    )  # fmt: skip
    assert found.healthy == sent.healthy
    resolution = {"sqrt_a": 2.0**-19, "eccentricity": 2.0**-33, "crc": 2.0**-5, "crs": 2.0**-5}
    resolution |= dict.fromkeys(("cuc", "cus", "cic", "cis"), 2.0**-29)
    resolution |= dict.fromkeys(("mean_anomaly", "node", "inclination", "perigee"), 3.2 * 2.0**-31)
    resolution |= dict.fromkeys(("mean_motion_difference", "node_rate", "inclination_rate"), 3.2 * 2.0**-43)
    resolution |= {"group_delay_s": 2.0**-31}
    for name, step in resolution.items():
        assert getattr(found, name) == pytest.approx(getattr(sent, name), abs=0.51 * step), name
    assert found.clock[0] == pytest.approx(sent.clock[0], abs=2.0**-31)
    assert found.clock[1] == pytest.approx(sent.clock[1], abs=2.0**-43)


@each("one", constellation()[::3])
def test_an_ephemeris_comes_back_from_its_words(one: Ephemeris) -> None:
    store = EphemerisStore()
    gps = one.satellite.constellation == Constellation.GPS
    words = lnav_subframes(one, NOW_NS) if gps else inav_pages(one, NOW_NS)
    found = [store.add_words(one.satellite, part, NOW_NS) for part in words]
    assert found[:-1] == [None] * (len(words) - 1) and found[-1] is not None
    assert_equal(found[-1], one)
    assert store.select(one.satellite, NOW_NS) == found[-1] and not store.rejected


@pytest.mark.parametrize("received_ns", [NOW_NS, NOW_NS + 500 * WEEK_NS, NOW_NS - 500 * WEEK_NS])
def test_the_week_is_resolved_within_512_weeks_of_reception(received_ns: int) -> None:
    store = EphemerisStore()
    words = lnav_subframes(ephemeris(GPS, 1.0, 0.5), NOW_NS)
    found = [store.add_words(GPS, part, received_ns) for part in words][-1]
    assert found is not None and found.toe_ns == TOE_NS


def test_a_reference_time_behind_the_end_of_the_week_belongs_to_the_next_week() -> None:
    end = 2301 * WEEK_NS
    one = replace(ephemeris(GPS, 1.0, 0.5), toe_ns=end, toc_ns=end)
    store = EphemerisStore()
    found = [store.add_words(GPS, part, end - 60 * 10**9) for part in lnav_subframes(one, end - 60 * 10**9)][-1]
    assert found is not None and found.toe_ns == end


@pytest.mark.parametrize("satellite", [GPS, GALILEO])
def test_parts_of_different_issues_make_no_ephemeris(satellite: SatelliteId) -> None:
    encode = lnav_subframes if satellite == GPS else inav_pages
    old, new = (replace(ephemeris(satellite, 1.0, 0.5), issue=issue) for issue in (57, 58))
    store = EphemerisStore()
    for words in encode(old, NOW_NS)[:2]:
        store.add_words(satellite, words, NOW_NS)
    assert all(store.add_words(satellite, words, NOW_NS) is None for words in encode(new, NOW_NS)[2:])


@each("bit", [6, 17, 29])
@each("word", range(10))
def test_a_flipped_bit_of_a_subframe_is_refused_and_counted(word: int, bit: int) -> None:
    words = list(lnav_subframes(ephemeris(GPS, 1.0, 0.5), NOW_NS)[1])
    words[word] ^= 1 << bit
    store = EphemerisStore()
    assert store.add_words(GPS, tuple(words), NOW_NS) is None
    assert store.rejected == {"bad_subframe": 1}


def test_every_flipped_bit_of_a_page_is_refused() -> None:
    words = inav_pages(ephemeris(GALILEO, 1.0, 0.5), NOW_NS)[0]
    assert galileo_inav.decode_page(words) is not None
    covered = [*range(114), *range(128, 128 + 106)]
    for position in covered:
        damaged = list(words)
        damaged[position // 32] ^= 1 << (31 - position % 32)
        assert galileo_inav.decode_page(tuple(damaged)) is None, f"bit {position}"


@each("words", [(), (1,) * 9, (0,) * 10, (0xFFFFFFFF,) * 10, (0,) * 8, (0xFFFFFFFF,) * 8, (0,) * 400])
@each("satellite", [GPS, GALILEO, SatelliteId(Constellation.GPS, 0), SatelliteId(Constellation.GALILEO, 99)])
def test_words_that_are_none_are_counted_and_nothing_is_kept(satellite: SatelliteId, words: tuple[int, ...]) -> None:
    store = EphemerisStore()
    store.add_words(satellite, words, NOW_NS)
    assert sum(store.rejected.values()) == 1 and store.select(satellite, NOW_NS) == "no_ephemeris"


def test_a_subframe_of_a_real_receiver_is_read() -> None:
    found = gps_lnav.decode_subframe(RECEIVED)
    assert found is not None and found.number in (4, 5)
    assert 0 <= found.next_tow_s < 604800 and found.next_tow_s % 6 == 0


def test_the_parity_of_a_word_is_that_of_the_interface_document() -> None:
    """Each parity bit written out from table 20-XIV, d1 first."""
    members = (
        (1, 2, 3, 5, 6, 10, 11, 12, 13, 14, 17, 18, 20, 23), (2, 3, 4, 6, 7, 11, 12, 13, 14, 15, 18, 19, 21, 24),
        (1, 3, 4, 5, 7, 8, 12, 13, 14, 15, 16, 19, 20, 22), (2, 4, 5, 6, 8, 9, 13, 14, 15, 16, 17, 20, 21, 23),
        (1, 3, 5, 6, 7, 9, 10, 14, 15, 16, 17, 18, 21, 22, 24), (3, 5, 6, 8, 9, 10, 11, 13, 15, 19, 22, 23, 24),
    )  # fmt: skip
    for data in (0x8B0000, 0x123456, 0xABCDEF, 0xFFFFFF, 1):
        bits = [data >> (24 - k) & 1 for k in range(25)]
        expected = [sum(bits[k] for k in row) % 2 for row in members]
        assert parity(data << 6) == int("".join(map(str, expected)), 2)


def test_the_ionosphere_is_read_from_page_18_and_from_no_other() -> None:
    for page, expected in ((56, IONOSPHERE), (57, None)):
        packer = Packer().put(0x8B, 8).put(0, 16).put(100, 17).put(0, 2).put(4, 3).put(0, 2).put(1, 2).put(page, 6)
        for value, power in zip(
            (*IONOSPHERE.alpha, *IONOSPHERE.beta), (30, 27, 24, 24, -11, -14, -16, -16), strict=True
        ):
            packer.scaled(value, 8, power)
        store = EphemerisStore()
        store.add_words(GPS, lnav_words(packer.text.ljust(240, "0")), NOW_NS)
        if expected is None:
            assert store.ionosphere is None
            continue
        assert store.ionosphere is not None
        assert store.ionosphere.alpha == pytest.approx(expected.alpha, abs=2.0**-24)
        assert store.ionosphere.beta == pytest.approx(expected.beta, abs=2.0**16)


@pytest.mark.parametrize(("index", "accuracy"), [(0, 0.0), (50, 0.5), (75, 1.0), (107, 3.12), (125, 6.0), (126, None)])
def test_the_accuracy_index_of_galileo_has_four_steps(index: int, accuracy: float | None) -> None:
    found = galileo_inav.accuracy_m(index)
    assert found is None if accuracy is None else found == pytest.approx(accuracy)

"""Collects broadcast navigation data of all satellites and selects the ephemeris to use."""

from shared.maths.gnss_signals import Klobuchar

from ..measurements import Constellation, SatelliteId
from . import galileo_inav, gps_lnav
from .ephemeris import MAX_AGE_S, Ephemeris, age_s

NUMBERS = {Constellation.GPS: range(1, 33), Constellation.GALILEO: range(1, 37)}
MIN_SQRT_A, MAX_SQRT_A = 4500.0, 6500.0  # [sqrt m] all navigation satellites in medium orbits, with margin
MAX_ECCENTRICITY = 0.2  # [-] Galileo's two satellites in wrong orbits have 0.16
PLAUSIBLE_CLOCK_S = 0.01  # [s] more than any clock polynomial that can be broadcast


class EphemerisStore:
    """Assembles ephemerides from subframes and pages, and finds the valid one nearest in time.

    `ionosphere` holds the newest Klobuchar coefficients, None before they were received; `rejected` counts data that
    were not used, by reason. Of each satellite the ephemerides that came last are kept: on line a few are enough, a
    navigation file of a whole day has up to 150.
    """

    def __init__(self, kept: int = 4) -> None:
        self._kept = kept
        self.ionosphere: Klobuchar | None = None
        self.rejected: dict[str, int] = {}
        self._subframes: dict[SatelliteId, dict[int, gps_lnav.Subframe]] = {}
        self._words: dict[SatelliteId, dict[int, galileo_inav.NavigationWord]] = {}
        self._ephemerides: dict[SatelliteId, dict[tuple[int, int], Ephemeris]] = {}

    def add_words(self, satellite: SatelliteId, words: tuple[int, ...], gps_time_ns: int) -> Ephemeris | None:
        """Take the words of one RXM-SFRBX; return the ephemeris that they complete.

        Parameters
        ----------
        satellite : SatelliteId
            Who sent it, on L1 C/A or E1-B.
        words : tuple of int
            32-bit words, as the receiver gives them.
        gps_time_ns : int
            [ns] Time of reception, to a minute.
        """
        if satellite.number not in NUMBERS[satellite.constellation]:
            self._reject("unknown_satellite")
            return None
        if satellite.constellation == Constellation.GPS:
            found = self._add_gps(satellite, words, gps_time_ns)
        else:
            found = self._add_galileo(satellite, words, gps_time_ns)
        return self.add(found) if found else None

    def add(self, ephemeris: Ephemeris) -> Ephemeris | None:
        """Keep an ephemeris, unless its orbit is impossible."""
        if not MIN_SQRT_A < ephemeris.sqrt_a < MAX_SQRT_A or not 0.0 <= ephemeris.eccentricity < MAX_ECCENTRICITY:
            self._reject("implausible_ephemeris")
            return None
        if abs(ephemeris.clock[0]) > PLAUSIBLE_CLOCK_S:
            self._reject("implausible_ephemeris")
            return None
        kept = self._ephemerides.setdefault(ephemeris.satellite, {})
        kept.pop((ephemeris.toe_ns, ephemeris.issue), None)
        kept[ephemeris.toe_ns, ephemeris.issue] = ephemeris
        while len(kept) > self._kept:
            del kept[next(iter(kept))]
        return ephemeris

    def satellites(self) -> tuple[SatelliteId, ...]:
        """All satellites of which an ephemeris is kept."""
        return tuple(self._ephemerides)

    def select(self, satellite: SatelliteId, gps_time_ns: int) -> Ephemeris | str:
        """Find the ephemeris nearest to an instant, or the reason why there is none: one word for counting."""
        kept = self._ephemerides.get(satellite)
        if not kept:
            return "no_ephemeris"
        # of equal age the one received last
        nearest = min(reversed(kept.values()), key=lambda ephemeris: age_s(ephemeris, gps_time_ns))
        if age_s(nearest, gps_time_ns) > MAX_AGE_S[satellite.constellation]:
            return "old_ephemeris"
        return nearest if nearest.healthy else "unhealthy_satellite"

    def _add_gps(self, satellite: SatelliteId, words: tuple[int, ...], gps_time_ns: int) -> Ephemeris | None:
        if (subframe := gps_lnav.decode_subframe(words)) is None:
            self._reject("bad_subframe")
            return None
        if ionosphere := gps_lnav.decode_ionosphere(subframe):
            self.ionosphere = ionosphere
        kept = self._subframes.setdefault(satellite, {})
        kept[subframe.number] = subframe
        if subframe.number > 3 or not kept.keys() >= {1, 2, 3}:
            return None
        return gps_lnav.decode_ephemeris(satellite.number, (kept[1], kept[2], kept[3]), gps_time_ns)

    def _add_galileo(self, satellite: SatelliteId, words: tuple[int, ...], gps_time_ns: int) -> Ephemeris | None:
        if (word := galileo_inav.decode_page(words)) is None:
            self._reject("bad_page")
            return None
        if word.number not in galileo_inav.EPHEMERIS_WORDS:
            return None
        kept = self._words.setdefault(satellite, {})
        kept[word.number] = word
        if len(kept) < len(galileo_inav.EPHEMERIS_WORDS):
            return None
        return galileo_inav.decode_ephemeris(satellite.number, kept, gps_time_ns)

    def _reject(self, reason: str) -> None:
        self.rejected[reason] = self.rejected.get(reason, 0) + 1

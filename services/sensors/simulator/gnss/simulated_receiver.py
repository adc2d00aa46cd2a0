"""The simulated GNSS receiver: a u-blox ZED-F9P on a serial line of 115,200 baud."""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from math import ceil, sqrt

import numpy as np
import numpy.typing as npt

from shared.maths.earth import geodetic_from_ned_difference
from shared.messages.base import Message
from shared.messages.gnss import GnssRaw

from ..attacks.signals import SatelliteFault, Signals
from ..devices import Delay, DeviceClock
from ..scenarios import Scenario
from ..vehicle import AntennaState, Stream
from . import nmea_encoder, ubx_encoder
from .navigation_words import galileo_words, gps_words
from .raw_measurements import IONOSPHERE, Phases, RangeErrors, measure
from .receiver_settings import Settings
from .reception import REACQUISITION_S, Fix, Reception, search_s
from .simulated_epoch import Baseline, Epoch, SentWords, gps_ms, signal_under
from .sky import MIN_SATELLITES, FloatArray, Sky, SkyModel, dilution

SOURCE = "gnss0"
MS = 1_000_000
BYTE_NS = 10 * 1_000_000_000 // 115_200
MAX_BACKLOG_NS = 1_000_000_000  # transmit backlog above which the receiver skips an epoch
RESPONSE_NS = 8 * MS  # from a written message to its response
CHUNK_BYTES = (120, 330)  # size of one read of the serial port
HEIGHT_SD = 1.5  # standard deviation of the height over the horizontal accuracy, where the receiver states another one
BASELINE_SD_M = 0.004  # standard deviation of the baseline between two antennas, across it
HOST_ERROR_MS = 30.0  # largest error of the host's clock at boot
ENCODERS = {**ubx_encoder.ENCODERS, **nmea_encoder.ENCODERS}


class Receiver:
    """Encodes antenna states as UBX and NMEA bytes, and executes UBX-CFG-VALSET."""

    def __init__(
        self,
        scenario: Scenario,
        seed: int,
        start_ns: int,
        clocks: np.random.Generator,
        protocols: tuple[str, ...],
        second_antenna_m: float = 0.0,
    ) -> None:
        self._scenario, self._seed, self._start_ns = scenario, seed, start_ns
        self.settings = Settings(protocols)
        self._sky = SkyModel(scenario.constellations, (seed, Stream.SATELLITES))
        # GNSS time is exact; the host's clock has an initial error and drifts.
        self._clock = DeviceClock(clocks, latest_start_ns=1)
        self._utc_start_ns = start_ns - round(clocks.uniform(-HOST_ERROR_MS, HOST_ERROR_MS) * MS)
        self._delay = Delay(0.050, 0.004, 0.080, clocks)
        self._chunks = np.random.default_rng((seed, Stream.SATELLITES, 1))
        self._second_antenna_m = second_antenna_m  # distance ahead of the first; 0: single antenna
        self._headings = np.random.default_rng((seed, Stream.SATELLITES, 2))
        self._phase_noise = np.random.default_rng((seed, Stream.SATELLITES, 3))
        self._free_ns = 0  # time at which the serial line has sent all queued bytes
        self._period_ms = self.settings.period_ms
        self._reception = Reception(scenario, seed, self._period_ms * 1e-3)
        self._next_ms = self._after(self._utc_start_ns // MS)
        self._fix: Fix | None = None  # of the last epoch
        self._faulty: dict[int, npt.NDArray[np.intp]] = {}  # satellites of each fault
        self._left: npt.NDArray[np.intp] | None = None  # satellites while few are left
        self._searches = np.random.default_rng((seed, Stream.SATELLITES, 4))
        self._search_until_ms = 0  # after a restart, on its clock

    @property
    def next_epoch_ns(self) -> int:
        """Time of the next epoch, in the time of the on-board unit."""
        return self._start_ns + self._clock.true_ns(self._next_ms * MS - self._utc_start_ns)

    def navigate(self, signals: Signals) -> Iterator[tuple[int, Message]]:
        """Yield (arrival time, message) of the next epoch, in chunks as read from a serial port."""
        epoch_ns, utc_ms = self.next_epoch_ns, self._next_ms
        self._next_ms = self._after(utc_ms)
        if self.settings.period_ms != self._period_ms:
            self._period_ms = self.settings.period_ms
            self._reception = Reception(self._scenario, self._seed, self._period_ms * 1e-3)
        index = (utc_ms - self._utc_start_ns // MS - 1) // self._period_ms
        epoch = self._measure(signals, index, utc_ms + round(signals.time_offset_s * 1e3))
        if self._free_ns > epoch_ns + MAX_BACKLOG_NS:
            return
        data = b"".join(ENCODERS[name](epoch) for name in self.settings.due(index))
        first = min(len(data), int(self._chunks.integers(*CHUNK_BYTES)))
        yield from self._send(data, self._delay.arrival_ns(epoch_ns) - first * BYTE_NS, first)

    def _measure(self, signals: Signals, index: int, utc_ms: int) -> Epoch:
        """Make an epoch of signals that state a time; errors of pseudoranges move the fix as least squares say."""
        source, gps_s = signals.source, gps_ms(utc_ms) * 1e-3
        loss_db = self._scenario.loss_db + signals.noise_rise_db
        sky = self._sky.at(
            gps_s, source.position, mask_deg=self._scenario.mask_deg, loss_db=loss_db, covered=source.covered
        )
        sky = self._few(sky, signals.satellites_left)
        covered = source.covered or bool(sky.used.sum() < MIN_SATELLITES) or utc_ms < self._search_until_ms
        true_fix = self._reception.fix(index, replace(source, covered=covered))
        errors, rates = self._faults(signals.faults, sky)
        phases = Phases(source.position, self._phase_noise.standard_normal(len(sky.satellite)))
        added = RangeErrors(errors + signals.path_m, rates + signals.path_rate_m_s)
        raw = measure(self._sky, sky, true_fix, gps_s, added, phases)
        fix, sky = self._faulty_fix(true_fix, sky, errors, rates)
        if signals.held and self._fix is not None:
            fix = self._fix
        self._fix = fix
        fix = _stated(fix, signals)
        words = self._words(sky, gps_ms(utc_ms))
        constellations, baseline = tuple(self._sky.rows), self._baseline(source)
        signal = signal_under(signals.noise_rise_db, signals.path_m, signals.path_rate_m_s, valid=fix.valid)
        return Epoch(utc_ms, fix, sky, constellations, baseline, raw, words, signal)

    def _faults(self, faults: tuple[SatelliteFault, ...], sky: Sky) -> tuple[FloatArray, FloatArray]:
        """Errors [m] of the pseudoranges of a sky and their derivatives [m/s], shape (n,) each."""
        errors, rates = np.zeros(len(sky.satellite)), np.zeros(len(sky.satellite))
        for fault in faults:
            if fault.key not in self._faulty:
                used = sky.satellite[sky.used & np.isin(sky.system, self._sky.navigation_systems)]
                rng = np.random.default_rng((self._seed, Stream.ATTACKS, fault.key))
                count = fault.satellites if fault.portion is None else ceil(fault.portion * len(used))
                self._faulty[fault.key] = rng.permutation(used)[:count]
            rows = np.isin(sky.satellite, self._faulty[fault.key])
            to_satellite_n = _directions(sky)[rows]
            errors[rows] += fault.error_m - to_satellite_n @ fault.offset_n
            rates[rows] += fault.rate_m_s - to_satellite_n @ fault.velocity_n
        return errors, rates

    def _few(self, sky: Sky, count: int | None) -> Sky:
        """Leave some satellites of one constellation, next to one another in azimuth; None: all of them."""
        if count is None:
            self._left = None
            return sky
        if self._left is None:
            self._left = _neighbouring(sky, count, self._sky.navigation_systems)
        used = sky.used & np.isin(sky.satellite, self._left)
        elevation, azimuth = np.radians(sky.elevation_deg), np.radians(sky.azimuth_deg)
        # The errors themselves are not kept, but their residuals have the same part orthogonal to fewer satellites.
        residual = self._sky.split(np.where(used, sky.residual_m, 0.0), sky.system, used, elevation, azimuth)[1]
        return replace(
            sky, used=used, cn0_db_hz=np.where(used, sky.cn0_db_hz, 0.0), residual_m=residual,
            dop=dilution(elevation[used], azimuth[used]),
        )  # fmt: skip

    def _faulty_fix(self, fix: Fix, sky: Sky, errors: FloatArray, rates: FloatArray) -> tuple[Fix, Sky]:
        """Move position, velocity and residuals as errors of pseudoranges and their derivatives do."""
        if not (fix.valid and (errors.any() or rates.any())):
            return fix, sky
        directions = (sky.system, sky.used, np.radians(sky.elevation_deg), np.radians(sky.azimuth_deg))
        shift, residual = self._sky.split(errors, *directions)
        speed, _ = self._sky.split(rates, *directions, one_clock=True)
        (north, east, down), (v_north, v_east, v_down) = shift.tolist(), (speed + fix.velocity_n).tolist()
        moved = replace(
            fix,
            position=geodetic_from_ned_difference((north, east, down), fix.position),
            velocity_n=(v_north, v_east, v_down),
        )
        return moved, replace(sky, residual_m=sky.residual_m + residual)

    def _words(self, sky: Sky, gps_ms: int) -> tuple[SentWords, ...]:
        """Subframes and pages of the used satellites that ended since the epoch before."""
        seconds = range((gps_ms - self._period_ms) // 1000 + 1, gps_ms // 1000 + 1)
        return tuple(sent for end_s in seconds for sent in self._words_at(sky, end_s))

    def _words_at(self, sky: Sky, end_s: int) -> Iterator[SentWords]:
        rows = np.flatnonzero(sky.used & np.isin(sky.system, self._sky.navigation_systems))
        for satellite, system in zip(sky.satellite[rows].tolist(), sky.system[rows].tolist(), strict=True):
            one = self._sky.orbits.elements(end_s, satellite)
            gps = self._sky.names[system] == "gps"
            words = gps_words(one, end_s, IONOSPHERE) if gps else galileo_words(one, end_s)
            if words is not None:
                yield SentWords(self._sky.rows[system].gnss_id, one.number, 0 if gps else 1, words)

    def _baseline(self, antenna: AntennaState) -> Baseline | None:
        if not self._second_antenna_m:
            return None
        sd = BASELINE_SD_M / self._second_antenna_m
        return Baseline(self._second_antenna_m, antenna.heading + sd * float(self._headings.standard_normal()), sd)

    def write(self, data: bytes, now_ns: int) -> Iterator[tuple[int, Message]]:
        """Yield (arrival time, message) of the receiver's responses to written bytes."""
        response = b"".join(self.settings.feed(data))
        if (start := self.settings.restart) is not None:
            self.settings.restart = None
            searched_s = search_s(start, self._searches) - REACQUISITION_S
            self._search_until_ms = self._next_ms - self._period_ms + round(1000.0 * searched_s)
        if response:
            yield from self._send(response, now_ns + RESPONSE_NS, len(response))

    def _after(self, utc_ms: int) -> int:
        """Time of the first epoch after `utc_ms`: epochs are at whole multiples of their period."""
        return (utc_ms // self.settings.period_ms + 1) * self.settings.period_ms

    def _send(self, data: bytes, begin_ns: int, first: int) -> Iterator[tuple[int, Message]]:
        """Divide bytes into chunks; each arrives when its last byte has been transmitted."""
        begin_ns = max(begin_ns, self._free_ns)
        position, size = 0, first
        while position < len(data):
            chunk = data[position : position + size]
            position += len(chunk)
            self._free_ns = begin_ns + position * BYTE_NS
            yield self._free_ns, GnssRaw(received_ns=self._free_ns, source=SOURCE, data=chunk)
            size = int(self._chunks.integers(*CHUNK_BYTES))


def _directions(sky: Sky) -> FloatArray:
    """Unit vectors [NED] to the satellites, shape (n, 3)."""
    elevation, azimuth = np.radians(sky.elevation_deg), np.radians(sky.azimuth_deg)
    level = np.cos(elevation)
    return np.column_stack([level * np.cos(azimuth), level * np.sin(azimuth), -np.sin(elevation)])


def _neighbouring(sky: Sky, count: int, systems: Sequence[int]) -> npt.NDArray[np.intp]:
    """Satellites next to one another in azimuth, of the constellation of which most are used, the highest one first."""
    kept = np.flatnonzero(sky.used & np.isin(sky.system, systems))
    if len(kept):
        kept = kept[sky.system[kept] == np.bincount(sky.system[kept]).argmax()]
        highest_deg = sky.azimuth_deg[kept[sky.elevation_deg[kept].argmax()]]
        apart = np.abs((sky.azimuth_deg[kept] - highest_deg + 180.0) % 360.0 - 180.0)
        kept = kept[np.argsort(apart)[:count]]
    satellites: npt.NDArray[np.intp] = sky.satellite[kept]
    return satellites


def _stated(fix: Fix, signals: Signals) -> Fix:
    """State another accuracy than that of the fix, where an attack does."""
    if not fix.valid:
        return fix
    if signals.position_accuracy_m is not None:
        level, height = signals.position_accuracy_m / sqrt(2.0), HEIGHT_SD * signals.position_accuracy_m
        fix = replace(fix, position_sd_n=(level, level, height))
    if signals.velocity_sd_m_s is not None:
        fix = replace(fix, velocity_sd_n=(signals.velocity_sd_m_s,) * 3)
    return fix

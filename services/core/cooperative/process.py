"""Finds the satellite whose pseudorange contradicts the others: plain RAIM on the receiver's raw measurements."""

from collections import Counter
from collections.abc import Iterator
from dataclasses import replace
from math import radians

from pydantic import Field

from shared.messages.base import Tick
from shared.messages.gnss import FaultFreeFix, GnssFix, GnssNavigationBits, GnssRawEpoch, RawMeasurement
from shared.messages.trust import TrustMonitor
from shared.runtime.config import Section

from .broadcast.store import EphemerisStore
from .fault_free import fault_free_fix
from .measurements import Constellation, Measurement, RawEpoch, SatelliteId
from .satellites.model import ErrorModel
from .satellites.monitor import RaimSettings, SatelliteMonitor
from .statements import Since, after, silent, statement

In = GnssRawEpoch | GnssNavigationBits | GnssFix | Tick
Out = TrustMonitor | FaultFreeFix
PERIOD_NS = 900_000_000  # epochs that follow faster are not evaluated: one a second is enough
SIGNALS = {("gps", "1C"), ("galileo", "1C"), ("galileo", "1B")}  # on 1575.42 MHz, with broadcast ephemerides
# Reasons for which a measurement is not used in the ordinary course of things; the others are rejects.
ORDINARY = {"no_ephemeris", "below_elevation_mask", "weak_signal", "alone_in_constellation"}


class Config(Section):
    """Design rates of the satellite test and limits of what is used."""

    false_alarm_rate: float = Field(default=1e-5, gt=0.0, lt=0.5, description="of the global test, per epoch")
    missed_detection_rate: float = Field(
        default=1e-4, gt=0.0, lt=0.5, description="of a bias of the minimal detectable size, per epoch"
    )
    elevation_mask_deg: float = Field(
        default=10.0, ge=0.0, lt=90.0, description="elevation below which satellites are not used"
    )
    silent_after_s: float = Field(
        default=3.0, gt=0.0, description="time without raw measurements after which the satellites are not evaluated"
    )


class Process:
    """Publishes the statement `satellites` with each raw epoch, or once a second why there is nothing to test."""

    def __init__(self, config: Config) -> None:
        self._silent_ns = round(config.silent_after_s * 1e9)
        model = replace(ErrorModel(), elevation_mask_rad=radians(config.elevation_mask_deg))
        self._monitor = SatelliteMonitor(
            RaimSettings(config.false_alarm_rate, config.missed_detection_rate, model=model)
        )
        self._store = EphemerisStore()
        self._rejected: Counter[str] = Counter()
        self._gps_minus_obu_ns: int | None = None
        self._source: str | None = None
        self._epoch_ns: int | None = None  # stamp of the newest epoch that was evaluated
        self._since = Since()

    @property
    def rejects(self) -> Counter[str]:
        """Rejected measurements and navigation words by reason."""
        return self._rejected + Counter(self._store.rejected)

    def handle(self, message: In) -> Iterator[Out]:
        """Use measurements and navigation words."""
        match message:
            case GnssRawEpoch():
                yield from self._use_epoch(message)
            case GnssNavigationBits():
                self._use_bits(message)
            case GnssFix():
                if message.gps_time_ns is not None:
                    self._gps_minus_obu_ns = message.gps_time_ns - message.sampled_ns
            case Tick():
                if self._is_silent(message.now_ns):
                    why = self._why_silent(message.now_ns)
                    yield self._remembered(silent(why, message.now_ns, self._epoch_ns, self._since))

    def _use_epoch(self, message: GnssRawEpoch) -> Iterator[Out]:
        if message.source != self._source:
            if not self._is_silent(message.sampled_ns):
                self._rejected["second_receiver"] += 1
                return
            self._source = message.source
        self._gps_minus_obu_ns = message.gps_time_ns - message.sampled_ns
        if self._epoch_ns is not None and 0 <= message.sampled_ns - self._epoch_ns < PERIOD_NS:
            return
        self._epoch_ns = message.sampled_ns
        measurements = tuple(measured for one in message.measurements if (measured := _measurement(one)))
        epoch = RawEpoch(message.gps_time_ns, measurements)
        verdict = self._monitor.evaluate(epoch, self._store)
        self._rejected.update({reason: n for reason, n in verdict.rejected.items() if reason not in ORDINARY})
        yield self._remembered(statement(verdict, epoch, message.sampled_ns, self._since))
        if (fix := fault_free_fix(verdict, message)) is not None:
            yield fix

    def _use_bits(self, message: GnssNavigationBits) -> None:
        if (message.constellation.value, message.signal) not in SIGNALS:
            return
        if self._gps_minus_obu_ns is None:
            self._rejected["navigation_words_without_time"] += 1
            return
        satellite = SatelliteId(Constellation(message.constellation.value), message.number)
        self._store.add_words(satellite, message.words, message.received_ns + self._gps_minus_obu_ns)

    def _is_silent(self, now_ns: int) -> bool:
        return self._epoch_ns is None or abs(now_ns - self._epoch_ns) > self._silent_ns

    def _why_silent(self, now_ns: int) -> str:
        if self._epoch_ns is None:
            return "no raw measurements: the receiver has sent no UBX-RXM-RAWX"
        return f"no raw measurements for {abs(now_ns - self._epoch_ns) / 1e9:.0f} s"

    def _remembered(self, published: TrustMonitor) -> TrustMonitor:
        self._since = after(published, self._since)
        return published


def _measurement(one: RawMeasurement) -> Measurement | None:
    """Measurement of a signal on L1 or E1 with a valid pseudorange; None of any other."""
    if (one.constellation.value, one.signal) not in SIGNALS or one.pseudorange_m is None:
        return None
    satellite = SatelliteId(Constellation(one.constellation.value), one.number)
    return Measurement(satellite, one.pseudorange_m, one.doppler_hz, one.cn0_db_hz)

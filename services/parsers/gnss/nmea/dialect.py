"""Decodes the NMEA sentences of one receiver."""

from collections.abc import Iterator

from shared.maths.clock_mapping import ClockMapping
from shared.maths.dates import DAY_NS
from shared.messages.gnss import GnssFix, GnssSatellites, GnssSignalQuality
from shared.messages.operation import MessageUse

from ..dialect import Dialect, Output, Stream
from ..gnss_time import Unwrapper
from ..lateness import MAX_DELAY_S, with_lateness
from .burst import POSITIONS, USED_SENTENCES, NmeaAssembler, NmeaEpoch, kind_of
from .epoch import fix_from_sentences
from .satellites import satellites_of
from .utc_steps import UtcSteps

SUFFIX = "/nmea"  # of the source of fixes: they are another solution than those of a better protocol


class NmeaDialect(Dialect):
    """Fixes and satellites, unless a protocol that tells more gives them."""

    name = "NMEA"
    positions = tuple(frozenset((kind,)) for kind in sorted(POSITIONS))

    def __init__(self, stream: Stream) -> None:
        super().__init__(stream)
        self._bursts = NmeaAssembler()
        self._day, self._steps = Unwrapper(DAY_NS), UtcSteps()
        self._clock, self._resets = ClockMapping(stream.minimum_delay_s, longest_delay_s=MAX_DELAY_S), 0
        self._newest: tuple[NmeaEpoch, int] | None = None  # epoch, and the time stamp of its fix [ns]

    def kind(self, frame: bytes) -> str:
        """Name without the talker; a proprietary sentence with its maker."""
        return kind_of(frame)

    def use(self, kind: str) -> MessageUse:
        """Unknown is what no table of sentences holds."""
        if kind in USED_SENTENCES:
            return MessageUse.USED
        return MessageUse.UNUSED if kind in KNOWN_SENTENCES else MessageUse.UNKNOWN

    def take(self, frame: bytes, received_ns: int) -> Iterator[Output]:
        """Add a sentence to its burst; yield the fix of each that is complete."""
        if self.use(self.kind(frame)) is not MessageUse.USED:
            return
        epochs = tuple(self._bursts.take(frame, received_ns))
        yield from self._satellites()
        for epoch in epochs:
            if not self.stream.has_better(epoch.last_received_ns):
                with self.stream.faults.decoding(received_ns):
                    yield from self._outputs(epoch)

    def _outputs(self, epoch: NmeaEpoch) -> Iterator[Output]:
        device_ns = self._day.unwrap(epoch.time_of_day_ns)
        device_ns, step_s = self._steps.continuous(device_ns, epoch.first_received_ns)
        fix = self._fix(epoch, device_ns)
        yield fix
        self._newest = epoch, fix.sampled_ns
        for time_step_s in self._time_steps(step_s):
            yield GnssSignalQuality(
                sampled_ns=fix.sampled_ns, received_ns=fix.received_ns, source=self.stream.source,
                time_step_s=time_step_s,
            )  # fmt: skip

    def _time_steps(self, step_s: int) -> Iterator[float | None]:
        """Steps of UTC by whole seconds, and of the clock mapping."""
        if step_s:
            yield float(step_s)
        if self._clock.resets > self._resets:
            self._resets = self._clock.resets
            yield self._clock.step_s

    def _satellites(self) -> Iterator[GnssSatellites]:
        """Publish the satellites of the newest fix when its burst has ended: they may be told behind it."""
        if self._newest is None or not self._bursts.has_ended(self._newest[0]):
            return
        epoch, sampled_ns = self._newest
        self._newest = None
        if (found := satellites_of(epoch, sampled_ns=sampled_ns, source=self.stream.source)) is not None:
            yield found

    def _fix(self, epoch: NmeaEpoch, device_ns: int) -> GnssFix:
        fix = fix_from_sentences(
            epoch,
            sampled_ns=self._clock.stamp(device_ns, epoch.first_received_ns),
            source=f"{self.stream.source}{SUFFIX}",
            rejects=self.stream.rejects,
            dates=self.stream.dates,
        )
        return with_lateness(fix, self._clock)


# Sentences of receivers that are known and give nothing: NMEA 0183 version 4.11, and what makers add.
KNOWN_SENTENCES = frozenset((
    "ALM", "BOD", "BWC", "DBT", "DCN", "DHV", "DTM", "GAL", "GBQ", "GBS", "GGQ", "GLC", "GLL", "GLQ", "GNQ",
    "GPQ", "GRS", "HDG", "HDM", "HTD", "MSK", "MSS", "MWV", "OSD", "ROT", "RTE", "TXT", "VBW", "VHW", "VLW",
    "VPW", "WPL", "XTE", "XTR", "PASHR", "PGRME", "PGRMF", "PGRMZ", "PMTK", "PQTM", "PSAT", "PSTI", "PSTM",
    "PTNL", "PUBX", "PUBX03", "PUBX04", "PUBX40", "PUBX41", "PRWIZCH",
))  # fmt: skip

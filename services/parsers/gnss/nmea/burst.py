"""Groups the sentences of one navigation epoch, which a receiver sends in a burst, in any order."""

from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import Any

from pynmea2.nmea import NMEASentence, ParseError

from shared.faults import FOREIGN
from shared.maths.dates import NS

from ..dialect import ContentError

MAX_GSA = 8  # of one epoch: one or two a constellation
MAX_GSV = 40  # of one epoch: some for each constellation and signal
UNTIMED = -1  # time of day of a burst of which no sentence with a time has come yet
MIN_PAUSE_NS = 20_000_000
Sentence = Any  # pynmea2 creates the fields at run time; an empty or absent one is None or ""
# Of any talker. The time of day in ZDA may be that of the next pulse: it gives the date, and does not mark an epoch.
USED_SENTENCES = frozenset(("RMC", "GGA", "GNS", "GST", "GSA", "GSV", "VTG", "ZDA", "HDT", "THS", "PUBX00"))
TIMED = {"RMC": 0, "GGA": 0, "GNS": 0, "GST": 0, "PUBX00": 2}  # index of the field with the time of day
POSITIONS = {"RMC", "GGA", "GNS", "PUBX00"}
NUMBERED = {"GSA": MAX_GSA, "GSV": MAX_GSV}
_parse: Callable[[str], Sentence] = NMEASentence.parse  # pynmea2 has no type annotations


class NmeaError(ContentError):
    """Invalid content of a sentence with a valid checksum; the text is the kind of reject."""


def kind_of(sentence: bytes) -> str:
    """Name a sentence without its talker; a proprietary one with its maker, of u-blox and Quectel with its number."""
    head, _, rest = sentence[1:].partition(b",")
    name = head.partition(b"*")[0].decode("ascii", "replace")[:12]
    if not name.startswith("P"):
        return name[2:] if len(name) == 5 else f"?{name}"
    return name + rest.partition(b",")[0].decode("ascii", "replace")[:2] if name == "PUBX" else name


@dataclass(slots=True)
class NmeaEpoch:
    """The sentences of one burst; `sentences` maps RMC, GGA, VTG, GSA0, GSA1 ... to the parsed sentence."""

    time_of_day_ns: int
    first_received_ns: int
    last_received_ns: int
    sentences: dict[str, Sentence] = field(default_factory=dict)
    arrivals_ns: dict[str, int] = field(default_factory=dict)

    def add(self, kind: str, parsed: Sentence, received_ns: int) -> None:
        """Add a sentence; too many of a kind are left out."""
        if kind in NUMBERED:
            number = sum(name.startswith(kind) for name in self.sentences)
            if number == NUMBERED[kind]:
                return
            kind += str(number)
        self.sentences[kind], self.arrivals_ns[kind] = parsed, received_ns
        self.first_received_ns = min(self.first_received_ns, received_ns)
        self.last_received_ns = received_ns

    def all(self, kind: str) -> list[Sentence]:
        """The sentences of a numbered kind."""
        return [parsed for name, parsed in self.sentences.items() if name.startswith(kind)]

    @property
    def kinds(self) -> set[str]:
        """The kinds that a fix waits for: satellites in view may be told later."""
        return {name for name in self.sentences if not name.startswith("GSV")}


class NmeaAssembler:
    """Groups sentences by their time of day and by the pauses between bursts, and yields each epoch once.

    A sentence with another time of day begins an epoch; behind a pause, so does one without time (GSA, VTG ...) or one
    that repeats a time. Sentences without time between a pause and the first time are of the epoch that it begins. An
    epoch is complete when every kind of sentence of the two previous epochs has been received, or when the next begins.
    """

    def __init__(self) -> None:
        self._epoch: NmeaEpoch | None = None
        self._kinds_before: deque[set[str]] = deque([set()], maxlen=2)
        self._pauses = Pauses()
        self._done = True

    def take(self, sentence: bytes, received_ns: int) -> Iterator[NmeaEpoch]:
        """Process one sentence of `USED_SENTENCES` with a valid checksum; yield the completed epochs.

        Raises
        ------
        NmeaError
            The sentence is invalid.
        """
        kind, parsed = kind_of(sentence), _read(sentence)
        if kind in TIMED and len(parsed.data) > TIMED[kind] and not _time_of(kind, parsed):
            return  # a receiver that has no time yet
        time_ns = time_of_day_ns(_time_of(kind, parsed)) if kind in TIMED else UNTIMED
        behind_a_pause = self._pauses.note(received_ns)
        if self._epoch is None or self._begins(self._epoch, kind, time_ns, behind_a_pause):
            yield from self._finish()
            self._epoch, self._done = self._next_epoch(self._epoch, time_ns, received_ns), False
        epoch = self._epoch
        if epoch.time_of_day_ns == UNTIMED:
            epoch.time_of_day_ns = time_ns
        epoch.add(kind, parsed, received_ns)
        known = epoch.time_of_day_ns != UNTIMED and all(self._kinds_before)
        if known and set.union(*self._kinds_before) <= epoch.kinds:
            yield from self._finish()

    def has_ended(self, epoch: NmeaEpoch) -> bool:
        """Whether another epoch has begun."""
        return epoch is not self._epoch

    @staticmethod
    def _begins(epoch: NmeaEpoch, kind: str, time_ns: int, behind_a_pause: bool) -> bool:
        if epoch.time_of_day_ns == UNTIMED:
            return False
        if time_ns in (UNTIMED, epoch.time_of_day_ns):
            # UTC that steps back by a second tells a time twice.
            return behind_a_pause and (time_ns == UNTIMED or kind in epoch.sentences)
        return True

    def _next_epoch(self, before: NmeaEpoch | None, time_ns: int, received_ns: int) -> NmeaEpoch:
        """Begin an epoch; what came without a time behind the pause is taken over."""
        epoch = NmeaEpoch(time_ns, received_ns, received_ns)
        pause_end_ns = self._pauses.next_burst()
        if before is not None:
            if pause_end_ns is not None:
                late = [name for name, ns in before.arrivals_ns.items() if ns >= pause_end_ns and name not in TIMED]
                for name in late:
                    epoch.add(
                        name if name in USED_SENTENCES else name[:3],
                        before.sentences.pop(name),
                        before.arrivals_ns.pop(name),
                    )
            self._kinds_before.append(before.kinds)
        return epoch

    def _finish(self) -> Iterator[NmeaEpoch]:
        epoch = self._epoch
        if not self._done and epoch and epoch.time_of_day_ns != UNTIMED and epoch.sentences.keys() & POSITIONS:
            yield epoch
        self._done = True


class Pauses:
    """Finds the pauses between bursts by the arrivals of sentences: the gap that is far longer than all others."""

    def __init__(self) -> None:
        self._last_ns: int | None = None
        self._longest_ns = self._second_ns = 0  # gaps since the burst before began
        self._end_ns = 0  # of the longest gap
        self._limits_ns: deque[int] = deque([0, 0], maxlen=2)  # of the last two bursts, above which a gap is a pause

    def note(self, received_ns: int) -> bool:
        """Note a sentence; True if it came behind a pause."""
        gap_ns = 0 if self._last_ns is None else max(received_ns - self._last_ns, 0)
        self._last_ns = received_ns
        if gap_ns > self._longest_ns:
            self._longest_ns, self._second_ns, self._end_ns = gap_ns, self._longest_ns, received_ns
        else:
            self._second_ns = max(self._second_ns, gap_ns)
        return all(self._limits_ns) and gap_ns > min(self._limits_ns)

    def next_burst(self) -> int | None:
        """Learn from the burst that ended; give the arrival that ended its pause, or None if there was none."""
        clear = self._longest_ns > max(2 * self._second_ns, MIN_PAUSE_NS)
        self._limits_ns.append((self._longest_ns + self._second_ns) // 2 if clear else 0)
        self._longest_ns = self._second_ns = 0
        return self._end_ns if clear else None


def time_of_day_ns(text: str) -> int:
    """Parse hhmmss.sss, leap second included (pynmea2 rejects it); raises NmeaError for an invalid time."""
    try:
        hour, minute, second = int(text[:2]), int(text[2:4]), float(text[4:])
    except ValueError as error:
        raise NmeaError("nmea_time") from error
    if not (0 <= hour < 24 and 0 <= minute < 60 and 0 <= second < 61):
        raise NmeaError("nmea_time")
    return (hour * 3600 + minute * 60) * NS + round(second * 1000) * (NS // 1000)


def _time_of(kind: str, parsed: Sentence) -> str:
    return str(parsed.data[TIMED[kind]]) if len(parsed.data) > TIMED[kind] else ""


def _read(sentence: bytes) -> Sentence:
    text = sentence.rpartition(b"*")[0].decode("ascii")  # the framer has verified the checksum
    if text[3:6] == "THS":  # pynmea2 does not know it: HDT with a mode
        text = f"{text[:3]}HDT{text[6:]}"
    try:
        return _parse(text)
    except (ParseError, *FOREIGN) as error:
        raise NmeaError("nmea_form") from error

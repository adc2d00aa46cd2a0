"""A batch: positions, events or a gap, with dense sequence numbers; as deflated CBOR, a column a quantity.

Numbers of a column are differences to the one before: ten reports of one second each take some 27 bytes.
"""

import re
import zlib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from enum import IntEnum
from math import isfinite
from typing import NamedTuple

from ..messages.trust import TrustLevel
from ..unpacked import BadPack, unpacked
from .cbor import BadCbor, decoded, encoded

VERSION = 1
MOST_REPORTS, MOST_EVENTS = 600, 100
MOST_BYTES, MOST_UNPACKED = 65_536, 262_144  # of a batch, and of its CBOR
MAX_SEQUENCE = 1 << 53
EARLIEST_MS, LATEST_MS = 1_577_836_800_000, 4_102_444_800_000  # 2020-01-01 and 2100-01-01, UTC
DIGEST_BYTES = 32
MOST_VALUES, MOST_TEXT = 4096, 16_384  # of an event
NAME = re.compile(r"[a-z][a-z0-9_]{0,31}/[a-z][a-z0-9_]{0,31}")
# Verdicts by their code, the gravest last: the worst of several is the greatest.
VERDICTS = (
    TrustLevel.SAFE, TrustLevel.CAUTION, TrustLevel.DEAD_RECKONING, TrustLevel.INITIALISING, TrustLevel.NO_FIX,
    TrustLevel.UNSAFE,
)  # fmt: skip


class BadBatch(ValueError):
    """Bytes that are no batch; the text says why, and ends a sentence."""


class Kind(IntEnum):
    """What a batch holds."""

    POSITIONS = 0
    EVENTS = 1
    GAP = 2


class Report(NamedTuple):
    """Position and verdict at one time; all but time and verdict are None without a position."""

    utc_ms: int
    latitude_e7: int | None  # [1e-7 deg]
    longitude_e7: int | None  # [1e-7 deg]
    height_cm: int | None  # above the ellipsoid
    north_cm_s: int | None
    east_cm_s: int | None
    level_dm: int | None  # horizontal protection level; None: there is none
    verdict: int  # place in `VERDICTS`


class Event(NamedTuple):
    """A message of the bus that matters to a centre."""

    utc_ms: int
    name: str  # topic
    content: Mapping[str, object]  # as in the JSON of the message


class Gap(NamedTuple):
    """What a gap stands for: reports that a full outbox dropped."""

    from_ms: int
    to_ms: int
    last: bytes  # SHA-256 of the last batch it stands for, which the next one names as the one before


# Largest value of each column of `Report`; the smallest is its negative, but for those that begin at 0.
LIMITS = (LATEST_MS, 900_000_000, 1_800_000_000, 10_000_000, 100_000, 100_000, 10_000_000, len(VERDICTS) - 1)
NOT_NEGATIVE = (6, 7)
_WITHOUT_POSITION = (1, 2, 3, 4, 5)


@dataclass(frozen=True)
class Batch:
    """Reports, events or a gap with the sequence numbers `first` to `first + count - 1` of an epoch."""

    kind: Kind
    epoch_ms: int  # creation time of the outbox, UTC
    first: int
    count: int
    previous: bytes  # SHA-256 of the batch before, zeros for the first of an epoch
    reports: tuple[Report, ...] = ()
    events: tuple[Event, ...] = ()
    gap: Gap | None = None

    @property
    def span_ms(self) -> tuple[int, int]:
        """First and last time [ms, UTC]; a clock that was set back may have mixed them."""
        if self.gap is not None:
            return self.gap.from_ms, self.gap.to_ms
        times = [report.utc_ms for report in self.reports] or [event.utc_ms for event in self.events]
        return min(times), max(times)


def verdict_code(level: TrustLevel) -> int:
    """Code of a verdict; the greatest is the gravest."""
    return VERDICTS.index(level)


def encode(batch: Batch) -> bytes:
    """Encode a batch; raises `BadBatch` for one that the other end would not take."""
    if batch.gap is not None:
        columns: object = list(batch.gap)
    else:
        columns = [_differences(column) for column in zip(*batch.reports, strict=True)]
    events = [[event.utc_ms, event.name, dict(event.content)] for event in batch.events]
    head = [VERSION, int(batch.kind), batch.epoch_ms, batch.first, batch.count, batch.previous]
    data = zlib.compress(encoded([*head, columns, events]))
    decode(data)
    return data


def decode(data: bytes) -> Batch:
    """Read a batch of anybody; raises `BadBatch`."""
    try:
        # It is signed as it was compressed, for which there are many forms as well: another form is another batch.
        content = decoded(unpacked(data, "zlib", MOST_UNPACKED), canonical=False)
    except (BadPack, BadCbor) as error:
        raise BadBatch(str(error)) from error
    match content:
        case [int() as version, *_] if version != VERSION:
            raise BadBatch(f"it is of version {version}, and this program reads {VERSION}")
        case [
            int(),
            int() as kind,
            int() as epoch,
            int() as first,
            int() as count,
            bytes() as previous,
            list() as columns,
            list() as events,
        ] if len(previous) == DIGEST_BYTES and EARLIEST_MS <= epoch <= LATEST_MS and bool not in map(type, content):
            pass  # True and False are no numbers here: a database tells them apart
        case _:
            raise BadBatch("its content is not that of a batch")
    if not (0 <= first < first + count <= MAX_SEQUENCE):
        raise BadBatch("its sequence numbers are out of range")
    return _body(Batch(_kind(kind), epoch, first, count, previous), columns, events)


def _kind(code: int) -> Kind:
    try:
        return Kind(code)
    except ValueError as error:
        raise BadBatch(f"{code} is no kind of batch") from error


def _body(head: Batch, columns: list[object], events: list[object]) -> Batch:
    """Read what a batch holds."""
    given = head.epoch_ms, head.first, head.count, head.previous
    if head.kind is Kind.GAP:
        if events:
            raise BadBatch("a gap has no events")
        return Batch(head.kind, *given, gap=_gap(columns))
    if head.kind is Kind.POSITIONS:
        if events or head.count > MOST_REPORTS:
            raise BadBatch("positions with events, or too many of them")
        return Batch(head.kind, *given, reports=tuple(_reports(columns, head.count)))
    if columns or len(events) != head.count or head.count > MOST_EVENTS:
        raise BadBatch("events with positions, too many of them, or not as many as it says")
    return Batch(head.kind, *given, events=tuple(_event(event) for event in events))


def _gap(columns: list[object]) -> Gap:
    match columns:
        case [int() as from_ms, int() as to_ms, bytes() as last] if (
            EARLIEST_MS <= from_ms <= LATEST_MS and EARLIEST_MS <= to_ms <= LATEST_MS and len(last) == DIGEST_BYTES
        ):
            return Gap(from_ms, to_ms, last)
    raise BadBatch("its gap says not when, or of what")


def _reports(columns: list[object], count: int) -> Iterable[Report]:
    if len(columns) != len(Report._fields):
        raise BadBatch(f"it has {len(columns)} columns, and positions have {len(Report._fields)}")
    values = [_sums(column, count, number) for number, column in enumerate(columns)]
    for row in zip(*values, strict=True):
        report = Report._make(row)
        nothing = [row[number] is None for number in _WITHOUT_POSITION]
        if row[0] is None or row[7] is None or any(nothing) != all(nothing):
            raise BadBatch("a report without time or verdict, or with half a position")
        if report.utc_ms < EARLIEST_MS:
            raise BadBatch("a report is of a time before 2020")
        yield report


def _differences(values: Sequence[int | None]) -> list[int | None]:
    """Differences to the last value that is known."""
    before, found = 0, list[int | None]()
    for value in values:
        found.append(None if value is None else value - before)
        before = before if value is None else value
    return found


def _sums(column: object, count: int, number: int) -> list[int | None]:
    """Values of a column of differences, within its limits."""
    if not isinstance(column, list) or len(column) != count:
        raise BadBatch("a column has not as many values as the batch says")
    value, found, most = 0, list[int | None](), LIMITS[number]
    least = 0 if number in NOT_NEGATIVE else -most
    for difference in column:
        if difference is None:
            found.append(None)
            continue
        if type(difference) is not int or not least <= value + difference <= most:
            raise BadBatch(f"{Report._fields[number]} has no possible value")
        value += difference
        found.append(value)
    return found


def _event(row: object) -> Event:
    match row:
        case [int() as utc_ms, str() as name, dict() as content] if EARLIEST_MS <= utc_ms <= LATEST_MS:
            if not NAME.fullmatch(name):
                raise BadBatch("an event has no name of a topic")
            _check_plain(content)
            return Event(utc_ms, name, content)
    raise BadBatch("an event is not a time, a name and content")


def _check_plain(content: dict[object, object]) -> None:
    """Raise `BadBatch` for what JSON in a database cannot hold, or for too much."""
    todo: list[object] = [content]
    number = 0
    while todo:
        value, number = todo.pop(), number + 1
        if number > MOST_VALUES:
            raise BadBatch("an event holds too many values")
        match value:
            case str() if len(value) > MOST_TEXT or "\0" in value:
                raise BadBatch("an event holds a text that is too long, or a zero in one")
            case None | bool() | str():
                pass
            case float() if not isfinite(value):
                raise BadBatch("an event holds a number that is none")
            case int() | float():
                pass
            case dict():
                if not all(isinstance(key, str) and "\0" not in key and len(key) <= MOST_TEXT for key in value):
                    raise BadBatch("an event holds a name that is no text")
                todo.extend(value.values())
            case list():
                todo.extend(value)
            case _:
                raise BadBatch("an event holds what JSON does not")

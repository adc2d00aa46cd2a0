"""Any unit that sends lines of text: CSV or JSON, by a mapping in the vehicle's file."""

import json
import math
import re
from collections.abc import Callable
from typing import Annotated, Literal

from pydantic import Field, model_validator

from shared.faults import FOREIGN
from shared.messages.imu import ImuRaw, ImuSamples
from shared.messages.operation import MessageUse
from shared.runtime.config import Section

from .arrivals import SampleClock
from .decoder import Batch, Decoder, SampleError, Stream

KIND = "line"
MAX_BYTES = 1024  # of a line
LINE_END = re.compile(rb"[\r\n]")
LINE_ENDS = re.compile(rb"\r?\n|\r")
Column = Annotated[str, Field(min_length=1, max_length=64)]
Columns = tuple[Column, Column, Column]


class LineForm(Section):
    """What the lines hold: numbers of columns from 1 on (csv), or names, with points between levels (json)."""

    form: Literal["csv", "json"] = Field(default="csv", description="kind of line")
    separator: str = Field(default=",", min_length=1, max_length=1, description="between the columns of a csv line")
    begins: str = Field(
        default="", max_length=32, description="what a line that is used begins with, as $IMU; it is no column"
    )
    acceleration: Columns = Field(
        default=("2", "3", "4"), description="columns of the specific force along x, y and z of the sensor"
    )
    acceleration_unit_m_s2: float = Field(default=1.0, description="one of its units, in m/s2; of g: 9.80665", gt=0)
    rate: Columns = Field(default=("5", "6", "7"), description="columns of the angular rate about x, y and z")
    rate_unit_rad_s: float = Field(default=1.0, gt=0, description="one of its units, in rad/s; of deg/s: 0.0174532925")
    time: str = Field(
        default="1",
        max_length=64,
        description="column of the time of the sample; empty: lines are spaced evenly, by their arrival",
    )
    time_unit_s: float = Field(default=1e-3, gt=0, description="one of its units, in s")

    @model_validator(mode="after")
    def _numbered(self) -> "LineForm":
        columns = (*self.acceleration, *self.rate, *([self.time] if self.time else []))
        if self.form == "csv" and not all(column.isdecimal() and 1 <= int(column) <= 200 for column in columns):
            raise ValueError("columns of csv lines are numbers from 1 to 200")
        return self


class LineImu(Decoder):
    """Reads one sample a line.

    `rejects` counts `line_form` (not of the form that is configured), `line_column` (a column is missing or no number),
    `line_length`, `repeated_sample`, `not_finite`, `out_of_range`.
    """

    def __init__(self, stream: Stream, form: LineForm) -> None:
        super().__init__(stream)
        self._form = form
        self._read: Callable[[bytes], Callable[[str], float]] = _csv(form) if form.form == "csv" else _json
        self._rest, self._last_ns = b"", -1
        self._arrivals = SampleClock(stream.minimum_delay_s)

    def take(self, raw: ImuRaw) -> ImuSamples | None:
        """Process the next bytes; the rest of a line is kept."""
        *lines, self._rest = LINE_END.split(self._rest + raw.data)
        if len(self._rest) > MAX_BYTES:
            self.stream.rejects["line_length"] += 1
            self._rest = b""
        used = [one for line in lines if (one := self._used(line.strip())) is not None]
        times = self._times(len(used), raw.received_ns)
        batch = Batch()
        for line, at_ns in zip(used, times, strict=True):
            with self.faults.decoding(raw.received_ns):
                self._take(batch, line, at_ns)
        return self.samples(batch, raw.received_ns) if batch.device_ns else None

    def stamps(self, batch: Batch, received_ns: int) -> tuple[int, ...]:
        """Times by the column of the time; without one they are known already."""
        return super().stamps(batch, received_ns) if self._form.time else tuple(batch.device_ns)

    def _used(self, line: bytes) -> bytes | None:
        """What is behind the beginning of a line that is read; others are counted by kind, but for empty ones."""
        begins = self._form.begins.encode()
        if begins and line.startswith(begins):
            return line[len(begins) :]
        if not line:
            return None
        if begins:
            self.count(f"{KIND} that begins otherwise", MessageUse.UNUSED)
        elif line.startswith(b"#"):
            self.count(f"{KIND} that begins with #", MessageUse.UNUSED)
        else:
            return line
        return None

    def _times(self, number: int, received_ns: int) -> tuple[int | None, ...]:
        """Times of lines that arrived together; None of those that state their own."""
        return (None,) * number if self._form.time or not number else self._arrivals.stamp(number, received_ns)

    def _take(self, batch: Batch, line: bytes, at_ns: int | None) -> None:
        try:
            self._add(batch, line, at_ns)
        except SampleError as fault:
            self.count(KIND, MessageUse.USED, fault)
        else:
            self.count(KIND, MessageUse.USED)

    def _add(self, batch: Batch, line: bytes, at_ns: int | None) -> None:
        if len(line) > MAX_BYTES:
            raise SampleError("line_length")
        form = self._form
        column = self._read(line)
        force = [column(name) * form.acceleration_unit_m_s2 for name in form.acceleration]
        rate = [column(name) * form.rate_unit_rad_s for name in form.rate]
        if at_ns is None:
            time_s = column(form.time) * form.time_unit_s
            if not math.isfinite(time_s) or abs(time_s) > 1e10:
                raise SampleError("out_of_range")
            at_ns = round(time_s * 1e9)
            if at_ns == self._last_ns:
                raise SampleError("repeated_sample")
            self._last_ns = at_ns
        self.add(batch, at_ns, force, rate)


class UndescribedLines(Decoder):
    """Lines of text without `[parsers.imu.line]`: each is the reject `line_not_described`."""

    def take(self, raw: ImuRaw) -> None:
        """Count the lines."""
        for _ in range(len(LINE_ENDS.findall(raw.data))):
            self.count(KIND, MessageUse.USED, SampleError("line_not_described"))


def _csv(form: LineForm) -> Callable[[bytes], Callable[[str], float]]:
    separator = form.separator.encode()

    def read(line: bytes) -> Callable[[str], float]:
        parts = line.lstrip(separator).split(separator) if form.begins else line.split(separator)
        return lambda name: _number(parts[int(name) - 1]) if int(name) <= len(parts) else _number(None)

    return read


def _json(line: bytes) -> Callable[[str], float]:
    try:
        document = json.loads(line)
    except (RecursionError, *FOREIGN) as error:
        raise SampleError("line_form") from error
    if not isinstance(document, dict):
        raise SampleError("line_form")

    def column(name: str) -> float:
        value: object = document
        for part in name.split("."):
            if isinstance(value, dict):
                value = value.get(part)
            elif isinstance(value, list) and part.isdecimal() and int(part) < len(value):
                value = value[int(part)]
            else:
                value = None
        return _number(value)

    return column


def _number(value: object) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float | str | bytes):
        raise SampleError("line_column")
    try:
        return float(value)
    except (ValueError, OverflowError) as error:
        raise SampleError("line_column") from error

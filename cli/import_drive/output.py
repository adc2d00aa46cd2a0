"""Writes the converted files of a drive to a recording, and says what was read."""

import heapq
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from rich.console import Console
from rich.progress import Progress
from rich.table import Table as Printed

from shared.bus.bus import Envelope
from shared.bus.codec import encode, signed, topic_name
from shared.errors import UserError
from shared.messages.base import Message, RawBytes, Sender
from shared.messages.explanation import Explanation
from shared.messages.imu import ImuSamples
from shared.messages.navigation import TruthState
from shared.recording import RecordingWriter
from shared.runtime.config import VehicleFile
from shared.topics import BY_MESSAGE
from shared.words.words import reason

from .conversion.convert import Conversion, Imported


@dataclass(frozen=True)
class Correction:
    """What was estimated of a file, and the setting of the mapping that fixes the value."""

    why: Explanation
    setting: str = ""

    @property
    def text(self) -> str:
        """In a sentence or two."""
        return reason(self.why) + (f" To fix the value: {self.setting}." if self.setting else "")


@dataclass(frozen=True)
class Part:
    """One converted file of the drive."""

    name: str
    sha256: str
    converted: Conversion
    correction: Correction | None = None  # what was estimated of its clock or axes

    def corrected(self, messages: Sequence[Imported], why: Explanation, setting: str = "") -> "Part":
        """Replace the messages, and state how they were corrected."""
        return replace(self, converted=replace(self.converted, messages=messages), correction=Correction(why, setting))


def arrival_ns(message: Imported) -> int:
    """When a message arrived [ns]; of a truth, when it was true."""
    return message.sampled_ns if isinstance(message, TruthState) else message.received_ns


def write(
    output: Path, parts: Sequence[Part], vehicle: VehicleFile, provenance: dict[str, str], progress: Progress
) -> None:
    """Write the messages of all files in order of arrival; raises `UserError` where that is not possible."""
    firsts = [arrival_ns(part.converted.messages[0]) for part in parts if part.converted.messages]
    if min(firsts, default=0) < 0:
        raise UserError("the times of the files are before 1970; add `start_utc_s = 1e9` or later to the mapping")
    messages = heapq.merge(*(part.converted.messages for part in parts), key=arrival_ns)
    task = progress.add_task(f"writing {output.name}", total=sum(len(part.converted.messages) for part in parts))
    draft = output.with_name(output.name + ".part")
    sequence: dict[str, int] = {}
    try:
        draft.unlink(missing_ok=True)
        writer = RecordingWriter(draft, vehicle=vehicle.name, vehicle_toml=vehicle.text, provenance=provenance)
        for message in messages:
            writer.write(_envelope(message, sequence))
            progress.advance(task)
        writer.close()
        draft.rename(output)
    except OSError as error:
        raise UserError(f"cannot write {output}: {error.strerror}; choose another path with --output") from error
    finally:
        draft.unlink(missing_ok=True)  # after an error, or Ctrl-C


def _envelope(message: Imported, sequence: dict[str, int]) -> Envelope:
    name = topic_name(message)
    producer = BY_MESSAGE[type(message)].producers[0]
    sequence[producer] = sequence.get(producer, 0) + 1
    sender = Sender(process=producer, incarnation=0, sequence=sequence[producer])
    return Envelope.of(name, signed(encode(message), sender), arrival_ns(message))


def print_summary(output: Path, parts: Sequence[Part]) -> None:
    """Print a row a file: rows, samples, rate, span and rejects."""
    table = Printed(box=None, pad_edge=False)
    for title in ("file", "rows", "samples", "rate", "span", "rejected"):
        table.add_column(title, justify="left" if title in ("file", "rejected") else "right")
    for part in parts:
        stamps = [stamp for message in part.converted.messages for stamp in stamps_of(message)]
        span_s = (stamps[-1] - stamps[0]) * 1e-9 if stamps else 0.0
        rate = f"{(len(stamps) - 1) / span_s:.2f} Hz" if span_s > 0.0 else "-"
        rejected = ", ".join(f"{count} {reason}" for reason, count in part.converted.rejects.items()) or "none"
        count = str(len(stamps)) if stamps else "-"
        table.add_row(part.name, str(part.converted.rows), count, rate, f"{span_s:.1f} s", rejected)
    console = Console()
    console.print(table)
    console.print(f"wrote {output} ({output.stat().st_size / 1e6:.1f} MB); next: obu solve {output}", soft_wrap=True)


def stamps_of(message: Message) -> tuple[int, ...]:
    """Stamps [ns] of the values of a message: of bytes, their arrival."""
    if isinstance(message, ImuSamples):
        return message.sampled_ns
    if isinstance(message, RawBytes):
        return (message.received_ns,)
    return (getattr(message, "sampled_ns"),)  # noqa: B009  # every other imported message has one stamp

"""What explains a verdict, a test or a problem: a code with values, which `shared/words` puts into words."""

from enum import Enum, StrEnum
from typing import Annotated

from pydantic import Field

from .base import MAX_STATISTIC, Integer, Message, Name

CODE = r"^[a-z][a-z0-9_]*(\.[a-z][a-z0-9_]*)+$"
QUOTED_LENGTH = 80
VALUES_MAXIMUM = 12
LIST_MAXIMUM = 32
EXPLANATIONS_MAXIMUM = 64
PASSAGE_DIGITS = 8
SIGNIFICANT = 6  # digits of a value


class ReferenceKind(StrEnum):
    """What a reference names."""

    SOURCE = "source"  # gnss, imu, odometer
    SATELLITE = "satellite"
    NEIGHBOUR = "neighbour"
    PROCESS = "process"
    LANE = "lane"
    TOPIC = "topic"
    PASSAGE = "passage"  # by the first digits of its ID


class Reference(Message):
    """Something that has a name of its own."""

    kind: ReferenceKind
    name: Name


def process(name: str) -> Reference:
    """Refer to a process."""
    return Reference(kind=ReferenceKind.PROCESS, name=name)


def topic(name: str) -> Reference:
    """Refer to a topic."""
    return Reference(kind=ReferenceKind.TOPIC, name=name)


def passage(passage_id: str) -> Reference:
    """Refer to a passage, by the digits that people name it by."""
    return Reference(kind=ReferenceKind.PASSAGE, name=passage_id[:PASSAGE_DIGITS])


class QuotedText(Message):
    """Text of a device, as it is."""

    quoted: Annotated[str, Field(max_length=QUOTED_LENGTH)]


Code = Annotated[str, Field(pattern=CODE, max_length=64)]  # begins with its owner
ValueName = Annotated[str, Field(pattern=r"^[a-z][a-z0-9_]*$", max_length=40)]  # of a number it ends in its unit
Word = Annotated[str, Field(pattern=r"^[a-z][a-z0-9_]*$", max_length=40)]  # of an enumeration
Number = Annotated[float, Field(ge=-MAX_STATISTIC, le=MAX_STATISTIC)]
Value = (
    Integer
    | Number
    | Word
    | QuotedText
    | Reference
    | Annotated[tuple[Word, ...], Field(max_length=LIST_MAXIMUM)]
    | Annotated[tuple[Reference, ...], Field(max_length=LIST_MAXIMUM)]
)


class Explanation(Message):
    """Why something is as it is: a code, its values by name, and what it is about."""

    code: Code
    values: Annotated[
        dict[ValueName, Value],
        Field(default_factory=dict, max_length=VALUES_MAXIMUM, exclude_if=lambda value: not value),
    ]
    subject: Reference | None = None


Explanations = Annotated[tuple[Explanation, ...], Field(max_length=EXPLANATIONS_MAXIMUM)]


def explain(code: str, subject: Reference | None = None, /, **values: object) -> Explanation:
    """Make an explanation; enumerations become their words, and floats are rounded to what the contract holds.

    A value of None, and one that is not a number, is left out.
    """
    kept = {name: _plain(value) for name, value in values.items() if value is not None and value == value}  # noqa: PLR0124
    return Explanation(code=str(code), values=kept, subject=subject)  # type: ignore[arg-type]  # checked by the model


def _plain(value: object) -> object:
    if isinstance(value, Enum):
        return value.value
    if isinstance(value, float):
        return float(f"{min(max(value, -MAX_STATISTIC), MAX_STATISTIC):.{SIGNIFICANT}g}")
    return tuple(_plain(item) for item in value) if isinstance(value, list | tuple) else value

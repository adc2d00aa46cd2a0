"""Reads the lists of figures and tables of the papers, and compares stored results with the numbers of their texts.

A list is a TOML file beside this one. `figures` and `tables` are the highest numbers that the project's documents name:
the papers themselves are not part of the repository. Each number up to them has a row, and so has each number that a
text states.
"""

import subprocess
import tomllib
from collections.abc import Sequence
from enum import StrEnum
from json import loads
from pathlib import Path
from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field, model_validator

from shared.errors import UserError

FOLDER = Path(__file__).parent
RESULTS = Path(__file__).resolve().parents[3] / "benchmarks" / "results" / "papers"
UNKNOWN = "The documents of this project do not state what it shows."
CODE = ("cli/papers", "services", "shared")  # of which a result may depend, in the repository
Json = object


class Status(StrEnum):
    """What became of a figure, a table or a number of the text."""

    REPRODUCED = "reproduced"  # a command computes it, and the stored numbers are within their tolerances
    FITTED = "fitted"  # computed and within its tolerances, by a simulation fitted to these numbers: no evidence
    DIFFERS = "differs"  # a command computes it, and ours is another number or another form
    NOT_REPRODUCED = "not reproduced"


HELD = (Status.REPRODUCED, Status.FITTED)  # numbers of these have a tolerance


class _Part(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid")


class Number(_Part):
    """A number that the text states, and where ours is in the stored result."""

    at: Annotated[tuple[int | str, ...], Field(min_length=1)]  # keys; `key=value` selects an object of a list
    paper: float
    tolerance: float | None = None  # share of the paper's number; None: it is shown beside ours, and differs
    at_most: bool = False  # the text gives a bound: a smaller number is no difference
    unit: str = ""


class Row(_Part):
    """One figure, table, or statement of the text."""

    item: str  # `figure 3`, `table 1`, `text: ...`
    shows: str = ""  # empty: the project's documents do not say
    status: Status
    command: str = ""
    test: str = ""  # `file::function` below tests/
    numbers: tuple[Number, ...] = ()
    reason: str = ""  # why it differs, or is not reproduced

    @model_validator(mode="after")
    def _is_complete(self) -> "Row":
        held = self.status in HELD
        if held and not (self.command and (self.test or self.numbers)):
            raise ValueError(f"{self.item}: {self.status.value} by which command, and held by which test or number?")
        if held and not self.numbers and "::" not in self.test:
            raise ValueError(f"{self.item}: {self.status.value} without a number, by which function of a test?")
        if self.status is not Status.REPRODUCED and not self.why:
            raise ValueError(f"{self.item}: {self.status.value}, and no reason")
        if held and any(number.tolerance is None for number in self.numbers):
            raise ValueError(f"{self.item}: {self.status.value} within which tolerance?")
        return self

    @property
    def why(self) -> str:
        """The reason; of a figure that is not described, that."""
        return self.reason or ("" if self.shows else UNKNOWN)


class Coverage(_Part):
    """The list of one paper."""

    number: str  # of the paper in the project's documents
    title: str
    figures: Annotated[int, Field(ge=0)]
    tables: Annotated[int, Field(ge=0)]
    rows: tuple[Row, ...]

    def missing(self) -> list[str]:
        """Figures and tables without exactly one row."""
        items = [row.item for row in self.rows]
        wanted = [f"figure {n}" for n in range(1, self.figures + 1)] + [f"table {n}" for n in range(1, self.tables + 1)]
        return [item for item in wanted if items.count(item) != 1] + sorted({i for i in items if items.count(i) > 1})


def names() -> list[str]:
    """Papers with a list."""
    return sorted(path.stem for path in FOLDER.glob("*.toml"))


def coverage(name: str) -> Coverage:
    """Read the list of a paper."""
    if name not in names():
        raise UserError(f"no paper {name}: choose of {', '.join(names())}")
    return Coverage.model_validate(tomllib.loads((FOLDER / f"{name}.toml").read_text(encoding="utf-8")))


def stored(name: str) -> dict[str, Json] | None:
    """Result that is kept in the repository; None where there is none, as in an installed unit."""
    path = RESULTS / f"{name}.json"
    if not path.is_file():
        return None
    document: dict[str, Json] = loads(path.read_text(encoding="utf-8"))
    return document


def later_commits(commit: object) -> int | None:
    """Commits after that of a stored result which change code that it may use; None where git does not know it."""
    base = str(commit).removesuffix("-dirty")
    if not base.isalnum():
        return None
    try:
        done = subprocess.run(
            ["git", "rev-list", "--count", f"{base}..HEAD", "--", *CODE], cwd=RESULTS.parents[2], capture_output=True,
            text=True, check=False,
        )  # fmt: skip
    except OSError:  # no git, or no clone: an installed unit
        return None
    return int(done.stdout) if done.returncode == 0 else None


def value_at(document: Json, at: Sequence[int | str]) -> float:
    """Number of a result.

    Raises
    ------
    KeyError
        There is none.
    """
    found = document
    for key in at:
        found = _inner(found, key)
    if not isinstance(found, int | float):
        raise KeyError(f"{'.'.join(map(str, at))} is no number")
    return float(found)


def _inner(found: Json, key: int | str) -> Json:
    if isinstance(found, dict) and key in found:
        return found[key]
    if isinstance(found, list):
        if isinstance(key, int) and key < len(found):
            return found[key]
        name, _, value = str(key).partition("=")
        chosen = [item for item in found if isinstance(item, dict) and str(item.get(name)) == value]
        if len(chosen) == 1:
            return chosen[0]
    raise KeyError(key)


def outside(row: Row, document: Json) -> list[str]:
    """Numbers of a row that miss the text's by more than their tolerance."""
    texts = []
    for number in row.numbers:
        ours = value_at(document, number.at)
        missed = ours - number.paper if number.at_most else abs(ours - number.paper)
        if number.tolerance is not None and missed > number.tolerance * abs(number.paper) + 1e-12:
            texts.append(f"{row.item}: {ours:.4g} {number.unit}, the text has {number.paper:g} {number.unit}")
    return texts


def compared(row: Row, document: Json | None) -> str:
    """The text's numbers beside ours."""
    if document is None:
        return "; ".join(f"{number.paper:g} {number.unit}".strip() for number in row.numbers)
    return "; ".join(
        f"{number.paper:g} {number.unit}: ours {value_at(document, number.at):.4g}".replace(" :", ":")
        for number in row.numbers
    )

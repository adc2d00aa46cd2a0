"""Puts explanations into words: a row for each code, in the language and the time zone of the viewer.

Rows are data without expressions. Those in English stand in `words.toml` beside the owner of the codes; `OWNERS` lists
the owners. Every other language is one file beside this module; what it lacks is said in English.
"""

import re
import tomllib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from datetime import UTC, datetime, tzinfo
from functools import cache
from math import degrees
from pathlib import Path
from typing import cast

from ..messages.explanation import Explanation, QuotedText, Reference, ReferenceKind, Value

REPOSITORY = Path(__file__).parents[2]
FOLDER = Path(__file__).parent
# Prefix of the codes: folder with `words.toml`.
OWNERS = {
    "trust": "services/core/trust",
    "fusion": "services/core/fusion",
    "spoofing": "services/core/spoofing",
    "motion": "services/core/motion_conflict",
    "evidence": "services/core/evidence",
    "cooperative": "services/core/cooperative",
    "banner": "services/monitoring/status/views",
    "broker": "shared/bus",
    "health": "services/monitoring/health",
    "toll": "services/core/toll",
    "ledger": "services/monitoring/ledger",
    "fleet": "fleet/alarms",
    "solve": "cli/solve",
    "import": "cli/import_drive",
    "recorder": "services/monitoring/recorder",
    "settings": "services/controller/settings",
    "setting": "shared/settings",
}
ENGLISH = "en"
LANGUAGES = (ENGLISH, "de", "fr")
REASON_LENGTH = 400  # of a message
PLACEHOLDER = re.compile(r"\{(\w+)(?::(?!(?:and|or)\})(\w+))?(?::(and|or))?\}")
SUBJECT, CLAUSE, REJECT = "subject", "clause", "reject"
Tables = dict[str, dict[str, str]]
Names = Mapping[str, Mapping[str, str]]


@dataclass(frozen=True)
class CodedText:
    """A code, and the text of its message, which is shown where the code has no words, or where there is no code."""

    text: str
    code: Explanation | None = None


@dataclass(frozen=True)
class Row:
    """Words of one code.

    A placeholder is `{name:quantity}` for a number, `{name:table}` for a word of an enumeration or several of them
    (joined by "or", as `{name:table:and}` by "and"), `{name}` or `{name:and}` for references, `{name}` for quotations,
    `{subject}` for the subject, and `{name:clause}` for the clause of another explanation. `statistic`, `threshold` and
    `window_s` may be those of the test that an explanation belongs to (`shared/trust`).
    """

    sentence: str = ""  # one line for a driver, without figures
    clause: str = ""  # a few words without capital and full stop, for the sentence of another code
    action: str = ""  # what to do
    detail: str = ""  # with figures: the `reason` of a message, and what stands behind "Why?"
    level: str = ""  # state that is shown while this code decides, where that is not the state of the message


def _reject(kind: str) -> str | None:
    from ..rejects import reason_of  # with all protocols, which most processes do without

    found = reason_of(kind)
    return found.meaning if found else None


def _seconds(value: float) -> str:
    for unit, length_s in (("h", 3600.0), ("min", 60.0)):
        if abs(value) >= 10.0 * length_s:
            return f"{value / length_s:.0f} {unit}"
    return f"{value:z.0f} s" if value == round(value) or abs(value) >= 60.0 else f"{value:z.1f} s"


def _plain_number(value: float) -> str:
    """Three digits, and never as a power of ten but for what is very small."""
    return f"{value:.3g}" if abs(value) < 999.5 else f"{value:.0f}"


def _speed(value: float) -> str:
    return f"{value:z.1f} m/s" if abs(value) >= 1.0 else f"{value:z.2f} m/s"


def _size(value: float) -> str:
    return f"{value * 1e-6:.0f} MB" if value >= 1e6 else f"{value * 1e-3:.0f} kB"


# A number's quantity: end of the names of its values, and how it is written. Angles are in radians or degrees.
QUANTITIES: dict[str, tuple[tuple[str, ...], Callable[[float], str]]] = {
    "distance": (("_m",), lambda value: f"{value:z.1f} m"),
    "length": (("_m",), lambda value: f"{value:z.2f} m"),
    "speed": (("_m_s",), _speed),
    "acceleration": (("_m_s2",), lambda value: f"{value:z.3f} m/s²"),
    "angle": (("_rad", "_deg"), lambda value: f"{value:z.1f}°"),
    "turn_rate": (("_deg_s",), lambda value: f"{value:z.2f}°/s"),
    "duration": (("_s",), _seconds),
    "time_offset": (("_s",), lambda value: f"{value:z.3f} s"),
    "clock_offset": (("_s",), lambda value: f"{1e9 * value:z.0f} ns"),
    "clock_drift": (("_ratio",), lambda value: f"{1e9 * value:z.0f} ns/s"),
    "ratio": (("_ratio",), lambda value: f"{value:.3f}"),
    "carrier_to_noise": (("_db_hz",), lambda value: f"{value:.1f} dB-Hz"),
    "level_difference": (("_db",), lambda value: f"{value:.1f} dB"),
    "factor": (("ratio",), _plain_number),
    "accuracy": (("_m",), lambda value: f"{_plain_number(value)} m"),
    "size": (("_bytes",), _size),
    "share": (("probability", "share"), lambda value: f"{_plain_number(100.0 * value)} %"),
    "number": (("statistic", "threshold", "count", "number"), _plain_number),
}
INSTANT = "instant"  # a stamp, shown as time of day
INSTANT_ENDING = "_ns"


@dataclass(frozen=True)
class Words:
    """All rows and names in one language; what it lacks is said by another one."""

    language: str
    rows: Mapping[str, Row]
    names: Names
    format: Mapping[str, str]
    otherwise: "Words | None" = None

    def row(self, code: str) -> Row:
        """Row of a code, empty where there is none."""
        return self.rows.get(code, Row())

    def sentence(self, explanation: Explanation, **causes: CodedText) -> str | None:
        """One line for a driver; None without a row that fits. `causes` are those that its placeholders name."""
        clauses = {name: self.clause(cause) for name, cause in causes.items()}
        found = self._render(self.row(explanation.code).sentence, explanation, clauses=clauses)
        return found or (self.otherwise.sentence(explanation, **causes) if self.otherwise else None)

    def clause(self, told: CodedText) -> str:
        """A few words for the sentence of another code; without a row that fits, the text of the message."""
        found = None if told.code is None else self._render(self.row(told.code.code).clause, told.code)
        return found or (self.otherwise.clause(told) if self.otherwise else told.text)

    def told(self, told: CodedText, zone: tzinfo = UTC) -> str:
        """One line with figures; without a row that fits, the text of the message."""
        return (None if told.code is None else self.detail(told.code, zone)) or told.text

    def action(self, explanation: Explanation) -> str | None:
        """What to do; None where the state says it."""
        found = self._render(self.row(explanation.code).action, explanation)
        return found or (self.otherwise.action(explanation) if self.otherwise else None)

    def detail(self, explanation: Explanation, zone: tzinfo = UTC) -> str | None:
        """One line with figures; None without a row that fits."""
        found = self._render(self.row(explanation.code).detail, explanation, zone)
        return found or (self.otherwise.detail(explanation, zone) if self.otherwise else None)

    def name(self, table: str, word: str) -> str:
        """Name of a word of an enumeration; an unknown one as it is, with spaces.

        The table `reject` is that of the registry, in English: what each reason of a reject means.
        """
        found = self.names.get(table, {}).get(word) or (_reject(word) if table == REJECT else None)
        return found or (self.otherwise.name(table, word) if self.otherwise else word.replace("_", " "))

    def references(self, named: Sequence[Reference]) -> str:
        """Names of references: "GNSS or the odometer"."""
        return self._joined([self._reference(reference) for reference in named], self.format["or"])

    def _render(
        self, template: str, explanation: Explanation, zone: tzinfo = UTC, clauses: Mapping[str, str] | None = None
    ) -> str | None:
        """Fill the placeholders; None where a value is missing or does not fit, as in a message of another release."""
        try:
            filled = PLACEHOLDER.sub(lambda match: self._filled(match, explanation, zone, clauses or {}), template)
        except (KeyError, TypeError, ValueError, OverflowError, OSError):
            return None
        return filled or None

    def _filled(
        self, found: re.Match[str], explanation: Explanation, zone: tzinfo, clauses: Mapping[str, str]
    ) -> str:  # fmt: skip
        name, kind = found[1], found[2]
        if kind == CLAUSE:
            return clauses[name]
        if name == SUBJECT:
            return self._reference(explanation.subject)
        value = explanation.values[name]
        if kind == INSTANT:
            at = datetime.fromtimestamp(_number(value) * 1e-9, zone)
            return f"{at:%H:%M:%S} {at.tzname()}"
        if kind in QUANTITIES:
            number = degrees(_number(value)) if name.endswith("_rad") else _number(value)
            return QUANTITIES[kind][1](number).replace(".", self.format["decimal"])
        if isinstance(value, tuple):
            return self._joined([self._single(item, kind) for item in value], self.format[found[3] or "or"])
        return self._single(value, kind)

    def _single(self, value: Value, table: str | None) -> str:
        if isinstance(value, Reference):
            return self._reference(value)
        if isinstance(value, QuotedText):
            return f"“{value.quoted}”"
        if not table or not isinstance(value, str):
            raise TypeError(f"{value!r} is written by the name of a table")
        return self.name(table, value)

    def _reference(self, reference: Reference | None) -> str:
        if reference is None:
            raise KeyError(SUBJECT)
        if reference.kind is ReferenceKind.SOURCE:
            return self.name("source", reference.name)
        kind = self.format.get(reference.kind)  # the names of satellites and processes say what they are
        return f"{kind} {reference.name}" if kind else reference.name

    def _joined(self, names: list[str], word: str) -> str:
        """Join names: "a, b or c"."""
        if not names:
            return self.format["nothing"]
        return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} {word} {names[-1]}"


def said(text: str, code: Explanation | None, zone: tzinfo = UTC) -> str:
    """Say why, of a message: by the words of its code, else by its own text as it is, else by the code itself."""
    return words().told(CodedText(text, code), zone) or (code.code if code else "")


def translated(text: str, code: Explanation | None) -> dict[str, str]:
    """Put a code into words of the languages other than English; empty for a message without a code."""
    if code is None:
        return {}
    return {language: words(language).told(CodedText(text, code)) for language in LANGUAGES if language != ENGLISH}


def reason(*explanations: Explanation) -> str:
    """Render the English details of codes of one's own, as they stand in messages."""
    return "; ".join(words().detail(explanation) or explanation.code for explanation in explanations)[:REASON_LENGTH]


def stated(explanation: Explanation) -> CodedText:
    """A code of one's own with its English detail."""
    return CodedText(reason(explanation), explanation)


@cache
def words(language: str = ENGLISH) -> Words:
    """Words of a language.

    Raises
    ------
    ValueError
        There is no such language, or a file has a row whose owner or field is unknown.
    """
    if language not in LANGUAGES:
        raise ValueError(f"no words in {language!r}; there are {', '.join(LANGUAGES)}")
    if language != ENGLISH:
        return _read(FOLDER / f"{language}.toml", Words(language, {}, {}, {}, words()))
    found = _read(FOLDER / "en.toml", Words(ENGLISH, {}, {}, {}))
    present = {owner: folder for owner, folder in OWNERS.items() if (REPOSITORY / folder).is_dir()}
    for owner, folder in present.items():  # a wheel of the unit has no control centre
        found = _read(REPOSITORY / folder / "words.toml", found, owner)
    return found


def _read(path: Path, base: Words, owner: str | None = None) -> Words:
    """Add the rows and names of a file to those that were read before."""
    data = tomllib.loads(path.read_text(encoding="utf-8"))
    names = dict(base.names)
    for table, record in cast(Tables, data.pop("names", {})).items():
        names[table] = {**names.get(table, {}), **record}
    how = {**base.format, **cast("dict[str, str]", data.pop("format", {}))}
    owners = {owner} if owner else set(OWNERS)
    if foreign := set(data) - owners:
        raise ValueError(f"{path}: rows of {', '.join(sorted(foreign))}; their owner is not in OWNERS of shared/words")
    known = {field.name for field in fields(Row)}
    rows = dict(base.rows)
    for prefix, table_of_rows in data.items():
        for short, row in cast(Tables, table_of_rows).items():
            if unknown := set(row) - known:
                raise ValueError(
                    f"{path}: {prefix}.{short} has {', '.join(sorted(unknown))}; a row has {sorted(known)}"
                )
            rows[f"{prefix}.{short}"] = Row(**row)
    return replace(base, rows=rows, names=names, format=how)


def _number(value: Value) -> float:
    if isinstance(value, int | float):
        return value
    raise TypeError(f"{value!r} is no number")

"""Every row of the words with its longest values: what `tests/golden/sentences.txt` holds for review."""

from collections.abc import Iterator, Mapping
from functools import cache

from shared.messages.explanation import (
    QUOTED_LENGTH,
    Explanation,
    QuotedText,
    Reference,
    ReferenceKind,
    explain,
    process,
)
from shared.words.words import CLAUSE, INSTANT, LANGUAGES, PLACEHOLDER, QUANTITIES, SUBJECT, CodedText, Words, words
from tests.support.data import REPOSITORY

FILE = REPOSITORY / "tests" / "golden" / "sentences.txt"
FIELDS = ("sentence", "clause", "action", "detail")
NUMBER, ANGLE, SHARE, STAMP_NS = 12345.6, 3.14, 0.123, 1_795_000_000 * 10**9
# Values that are lists, and how many of them a sentence names, or a detail can.
LISTS = {
    "suspects": 2, "monitors": 10, "supporting": 5, "contradicting": 5, "accused": 16, "satellites": 16,
    "suspected_satellites": 16, "neighbours": 16, "sources": 4, "differences": 5, "missing": 9,
}  # fmt: skip
LISTS |= {"topics": 16, "senders": 3, "axes": 2}
QUOTED = ("clients", "error", "folder", "operator", "answer", "tariff_class", "file")  # texts of others
PROCESS = process("core.motion_conflict")


def longest(code: str, spoken: Words) -> Explanation:
    """An explanation with the longest values that the words of a code name."""
    row, english = spoken.row(code), words().row(code)
    texts = [getattr(item, field) for item in (row, english) for field in FIELDS]
    found = {match[1]: match[2] for text in texts for match in PLACEHOLDER.finditer(text)}
    values = {name: _value(name, kind, spoken) for name, kind in found.items() if kind != CLAUSE and name != SUBJECT}
    subject = Reference(kind=ReferenceKind.SOURCE, name="imu") if code.startswith("trust.") else PROCESS
    return explain(code, subject if SUBJECT in found else None, **values)


def texts(code: str, spoken: Words) -> Mapping[str, str | None]:
    """Render what a code says with its longest values, a sentence that names a cause with the longest of these."""
    explanation = longest(code, spoken)
    return {
        "sentence": spoken.sentence(explanation, cause=longest_cause(spoken)),
        "clause": spoken.clause(CodedText("", explanation)) or None,
        "action": spoken.action(explanation),
        "detail": spoken.detail(explanation),
    }


@cache
def _longest_cause(language: str) -> CodedText:
    spoken = words(language)
    every = [CodedText("", longest(code, spoken)) for code, row in words().rows.items() if row.clause]
    return max(every, key=lambda told: len(spoken.clause(told)))


def longest_cause(spoken: Words) -> CodedText:
    """The longest clause of a language."""
    return _longest_cause(spoken.language)


def _value(name: str, kind: str | None, spoken: Words) -> object:
    if not kind and name in QUOTED:
        return QuotedText(quoted="x" * QUOTED_LENGTH)
    if not kind and name in LISTS:
        return (Reference(kind=ReferenceKind.SATELLITE, name="G05"),) * LISTS[name]
    if not kind:
        return PROCESS
    if kind in QUANTITIES:
        return {"angle": ANGLE, "share": SHARE}.get(kind, NUMBER)
    if kind == INSTANT:
        return STAMP_NS
    table = {**words().names[kind], **spoken.names.get(kind, {})}
    by_length = sorted(table, key=lambda word: -len(table[word]))
    return tuple(by_length[: LISTS[name]]) if name in LISTS else by_length[0]


def lines() -> Iterator[str]:
    """Yield the snapshot: every language, every code, what it says."""
    for language in LANGUAGES:
        spoken = words(language)
        for code in spoken.rows:
            for field, text in texts(code, spoken).items():
                if text and getattr(spoken.row(code), field):
                    yield f"{language} {code} {field}: {text}"


def main() -> None:
    """Write the snapshot."""
    FILE.write_text("\n".join(lines()) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()

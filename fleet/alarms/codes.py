"""Codes of alarms, made of the kind and the detail in the database; `words.toml` beside this file has their words."""

from collections.abc import Mapping
from enum import StrEnum

from pydantic import ValidationError

from shared.messages.explanation import Explanation, explain


class Code(StrEnum):
    """What an alarm says of a vehicle."""

    UNSAFE = "fleet.unsafe"
    SILENT = "fleet.silent"
    MISSING = "fleet.missing"  # reports, by their numbers
    DROPPED = "fleet.dropped"  # by a full outbox, as the vehicle states
    SIGNATURE = "fleet.signature"
    FLOOD = "fleet.flood"


# Kind of the alarm, its code, and which field of its detail each value is.
OF_KIND: tuple[tuple[str, Code, dict[str, str]], ...] = (
    ("unsafe", Code.UNSAFE, {}),
    ("silent", Code.SILENT, {"after_s": "after_s"}),
    ("gap", Code.MISSING, {"missing_count": "missing"}),
    ("gap", Code.DROPPED, {"dropped_count": "dropped"}),
    ("signature", Code.SIGNATURE, {"batch_count": "count", "refusal": "reason"}),
    ("flood", Code.FLOOD, {"batch_count": "withheld", "budget": "budget"}),
)


def code_of(kind: str, detail: Mapping[str, object]) -> Explanation | None:
    """Give the code of an alarm with its values; None of a kind or a detail of another release."""
    for of, code, fields in OF_KIND:
        if of == kind and detail.keys() >= set(fields.values()):
            try:
                return explain(code, None, **{name: detail[field] for name, field in fields.items()})
            except ValidationError:
                return None
    return None

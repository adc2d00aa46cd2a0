"""`python -m shared.settings.check`: what a change of settings would do, judged as each process would judge it.

This needs the models of all processes, which take some 100 MB: a program of its own, which ends with its answer.
"""

import json
import re
import sys
from collections.abc import Collection, Iterator, Mapping
from enum import StrEnum

from pydantic import ValidationError

from ..errors import ConfigError, UserError
from ..messages.explanation import QUOTED_LENGTH, Explanation, QuotedText, explain
from ..messages.settings import SettingDifference, SettingRow
from ..recording.writer import without_users
from ..runtime.config import VehicleFile, parse_vehicle
from .catalogue import FACTS, Setting, catalogue, find, value_of, values_of
from .digests import digest_in
from .edit import REMOVED, checked, differences, edited, touched
from .question import Answer, Question

MEANING, VALUE = 600, 4000  # characters of a message
# With another name or role the unit is another one: its secrets, topics and processes follow from them. What names a
# program to be run, or a file or folder to be read, written or served, would give the page what processes may touch.
FIXED = re.compile(rf"{FACTS}\.(name|role)|.*(^|[._])(command|file|files|folder|folders|dir)")
OPENS_FILE = re.compile(r"(?i)\s*file:|[?&;]\w*file=")
TOO_LONG = "(too long to be shown)"
SHORT = 300  # characters of a difference


class Code(StrEnum):
    """Why a change of settings is refused."""

    UNKNOWN = "setting.unknown"
    INVALID = "setting.invalid"
    FIXED = "setting.fixed"
    SECRET = "setting.secret"
    NOTHING = "setting.nothing"
    UNREADABLE = "setting.unreadable"


def answer(question: Question) -> Answer:
    """Judge a change; without one, describe the text that holds."""
    try:
        before = parse_vehicle(question.text, question.path)
        stored = {name: _stored(before, name) for name in question.changes}
        if fixed := [name for name, value in stored.items() if FIXED.fullmatch(name) or len(value) > VALUE]:
            return Answer(refusals=tuple(refusal(Code.FIXED, setting=name) for name in fixed))
        if question.replacement is None:
            changed, refusals = asked_values(question.changes, (FACTS, *before.processes))
            # A change would lose what is not shown.
            refusals += tuple(refusal(Code.SECRET, setting=name) for name, value in stored.items() if _has_user(value))
            if refusals:
                return Answer(refusals=refusals)
            text = edited(question.text, changed) if changed else question.text
        else:
            text = question.replacement
        after = checked(text, question.path)
        try:
            changes = differences(before, after)
            names = touched(changes, after, before)
        except ConfigError:  # the text that holds is invalid: it cannot be compared, and is replaced
            changes, names = [], list(after.processes)
    except ConfigError as error:
        return Answer(refusals=(refusal(Code.INVALID, error=error.cause),))
    except UserError as error:
        return Answer(refusals=(refusal(Code.UNREADABLE, error=str(error)),))
    asked = bool(question.changes) or question.replacement is not None
    if asked and not changes and text == question.text:
        return Answer(refusals=(explain(Code.NOTHING),))
    return Answer(
        text=text,
        differences=tuple(
            SettingDifference(name=one.setting.name, before=_short(one.before), after=_short(one.after))
            for one in changes
        ),
        touched=tuple(names),
        digests=digests(after),
        settings=tuple(rows(after)),
        counts=tuple(_count(after, text, question.path) for text in question.earlier),
    )  # fmt: skip


def asked_values(
    changes: Mapping[str, str | None], sections: Collection[str]
) -> tuple[dict[str, object], tuple[Explanation, ...]]:
    """Values of changes by name, and what is wrong with them; those of other sections are unknown."""
    values: dict[str, object] = {}
    refusals: list[Explanation] = []
    for name, text in changes.items():
        try:
            if find(name).section not in sections:
                raise UserError(name)
            value: object = None if text is None else json.loads(text)
        except UserError:
            refusals.append(refusal(Code.UNKNOWN, setting=name))
            continue
        except ValueError as error:
            refusals.append(refusal(Code.INVALID, error=f"{name}: {error}"))
            continue
        if _has_user(_plainly(value)):
            refusals.append(refusal(Code.SECRET, setting=name))
        elif any(isinstance(one, str) and OPENS_FILE.search(one) for one in _leaves(value)):
            refusals.append(refusal(Code.FIXED, setting=name))
        elif value is not None and any(one is None for one in _leaves(value)):
            refusals.append(refusal(Code.INVALID, error=f"{name}: a list or table holds no null"))
        values[name] = REMOVED if value is None else value
    return values, tuple(refusals)


def rows(file: VehicleFile) -> list[SettingRow]:
    """Every setting of a file's processes with its value."""
    return [_row(setting, value) for setting, value in values_of(file, catalogue(file.role, file.processes)).items()]


def digests(file: VehicleFile) -> dict[str, str]:
    """Digest of what each process reads."""
    return {name: digest_in(name, file) for name in file.processes}


def shown(value: object) -> str:
    """Value as JSON, without users and passwords of addresses; one that is too long is not shown."""
    text = without_users(_plainly(value))
    return text if len(text) <= VALUE else json.dumps(TOO_LONG)


def refusal(code: Code, **texts: str) -> Explanation:
    """Explain with quoted texts."""
    return explain(
        code, **{name: QuotedText(quoted=without_users(text)[:QUOTED_LENGTH]) for name, text in texts.items()}
    )


def _short(value: object) -> str:
    """Value of a difference: what it begins with, where it is long."""
    text = shown(value)
    return text if len(text) <= SHORT else json.dumps(f"{text[: SHORT - 20]} ...", ensure_ascii=False)[:VALUE]


def _leaves(value: object) -> Iterator[object]:
    if isinstance(value, dict):
        value = list(value.values())
    if isinstance(value, list):
        for one in value:
            yield from _leaves(one)
    else:
        yield value


def _stored(file: VehicleFile, name: str) -> str:
    """Value that holds of a setting, as JSON; null where its section is invalid or the setting unknown."""
    try:
        return _plainly(value_of(file, find(name)))
    except UserError:
        return _plainly(None)


def _has_user(text: str) -> bool:
    """Whether a value holds a user or password of an address."""
    return without_users(text) != text


def _plainly(value: object) -> str:
    return json.dumps(value, ensure_ascii=False)


def _row(setting: Setting, value: object) -> SettingRow:
    return SettingRow(
        name=setting.name, kind=setting.kind, value=shown(value), default=shown(setting.default),
        bounds=setting.bounds, choices=setting.choices, meaning=setting.meaning[:MEANING],
    )  # fmt: skip


def _count(file: VehicleFile, earlier: str, path: str) -> int | None:
    """Settings that an earlier text has otherwise; None where it cannot be read, as one of another release."""
    try:
        return len(differences(parse_vehicle(earlier, path), file))
    except UserError:
        return None


def main() -> None:
    """Answer the question on standard input."""
    try:
        question = Question.model_validate_json(sys.stdin.buffer.read())
    except ValidationError as error:
        sys.exit(f"no question: {error}")
    sys.stdout.write(answer(question).model_dump_json())


if __name__ == "__main__":
    main()

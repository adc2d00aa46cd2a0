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
from ..processes import BY_NAME, switchable
from ..recording.writer import without_users
from ..runtime.config import VehicleFile, parse_vehicle
from .catalogue import FACTS, Setting, catalogue, find, value_of, values_of
from .digests import digest_in
from .edit import REMOVED, checked, differences, edited, touched, with_sections
from .question import Answer, Question
from .sets import values_of_sets

MEANING, VALUE = 600, 4000  # characters of a message
# With another name or role the unit is another one: its secrets, topics and processes follow from them. What names a
# program to be run, or a file or folder to be read, written or served, would give the page what processes may touch.
FIXED = re.compile(rf"{FACTS}\.(name|role)|.*(^|[._])(command|file|files|folder|folders|dir)")
OPENS_FILE = re.compile(r"(?i)\s*file:|[?&;]\w*file=")
TOO_LONG = "(too long to be shown)"
SHORT = 300  # characters of a difference
TRUE, FALSE = "true", "false"


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
        switches, values = _parted(question.changes, switchable(before.role))
        stored = {name: _stored(before, name) for name in values}
        if fixed := [name for name, value in stored.items() if _is_fixed(name, value, values[name])]:
            return Answer(refusals=tuple(refusal(Code.FIXED, setting=name) for name in fixed))
        if question.replacement is None:
            runs = {name: value == TRUE for name, value in switches.items()}
            sections = [name for name in (*before.processes, *runs) if runs.get(name, True)]
            changed, refusals = asked_values(values, (FACTS, *sections))
            refusals += tuple(
                refusal(Code.INVALID, error=f"{name}: true and false are possible, and not {value}")
                for name, value in switches.items() if value not in (TRUE, FALSE, None)
            )  # fmt: skip
            # A change would lose what is not shown.
            refusals += tuple(refusal(Code.SECRET, setting=name) for name, value in stored.items() if _has_user(value))
            if refusals:
                return Answer(refusals=refusals)
            text = with_sections(question.text, runs) if runs else question.text
            text = edited(text, changed) if changed else text
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
        differences=(
            *_switched(before, after),
            *(
                SettingDifference(name=one.setting.name, before=_short(one.before), after=_short(one.after))
                for one in changes
            ),
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
    """Every setting of a file's processes with its value, and of each process that may run whether it does."""
    settings = values_of(file, catalogue(file.role, file.processes)).items()
    return [
        *(_row(setting, value) for setting, value in settings),
        *(
            SettingRow(
                name=name, kind="boolean", value=TRUE if name in file.processes else FALSE, default=FALSE,
                meaning=BY_NAME[name].purpose[:MEANING],
            ) for name in switchable(file.role)
        ),
    ]  # fmt: skip


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


def _parted(
    changes: Mapping[str, str | None], switches: Collection[str]
) -> tuple[dict[str, str | None], dict[str, str | None]]:
    """Changes of whether processes run, by their names, and those of settings."""
    return (
        {name: value for name, value in changes.items() if name in switches},
        {name: value for name, value in changes.items() if name not in switches},
    )


def _switched(before: VehicleFile, after: VehicleFile) -> Iterator[SettingDifference]:
    for name in switchable(after.role):
        was, runs = (TRUE if name in file.processes else FALSE for file in (before, after))
        if was != runs:
            yield SettingDifference(name=name, before=was, after=runs)


def _is_fixed(name: str, stored: str, asked: str | None) -> bool:
    """Whether a setting cannot be changed; a value of a set of hardware of this release may always be chosen."""
    if len(stored) > VALUE:
        return True
    chosen = stored if asked is None else asked
    return FIXED.fullmatch(name) is not None and chosen not in values_of_sets().get(name, ())


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

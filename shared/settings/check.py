"""`python -m shared.settings.check`: what a change of settings would do, judged as each process would judge it.

This needs the models of all processes, which take some 100 MB: a program of its own, which ends with its answer.
"""

import json
import sys
from collections.abc import Collection, Mapping
from enum import StrEnum

from pydantic import ValidationError

from ..errors import ConfigError, UserError
from ..messages.explanation import QUOTED_LENGTH, Explanation, QuotedText, explain
from ..messages.settings import SettingDifference, SettingRow
from ..recording.writer import without_users
from ..runtime.config import VehicleFile, parse_vehicle
from .catalogue import FACTS, Setting, catalogue, find, section_of, settings_of, values_of
from .digests import digest_for
from .edit import REMOVED, checked, differences, edited, touched
from .question import Answer, Question

MEANING, VALUE = 600, 4000  # characters of a message
# With another name or role the unit is another one: its secrets, topics and processes follow from them. What names a
# program to be run, or a folder to be served, gives more than the settings of a process.
FIXED = (f"{FACTS}.name", f"{FACTS}.role", "sensors.power.power_off_command", "monitoring.status.static_dir")


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
        if fixed := [name for name in question.changes if name in FIXED]:
            return Answer(refusals=tuple(refusal(Code.FIXED, setting=name) for name in fixed))
        if question.replacement is None:
            changed, refusals = asked_values(question.changes, (FACTS, *before.processes))
            if refusals:
                return Answer(refusals=refusals)
            text = edited(question.text, changed) if changed else question.text
        else:
            text = question.replacement
        after = checked(text, question.path)
        changes = differences(before, after)
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
            SettingDifference(name=one.setting.name, before=shown(one.before), after=shown(one.after))
            for one in changes
        ),
        touched=tuple(touched(changes, after, before)),
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
            value: object = REMOVED if text is None else json.loads(text)
        except UserError:
            refusals.append(refusal(Code.UNKNOWN, setting=name))
            continue
        except ValueError as error:
            refusals.append(refusal(Code.INVALID, error=f"{name}: {error}"))
            continue
        if text is not None and shown(value) != _plainly(value):
            refusals.append(refusal(Code.SECRET, setting=name))
        values[name] = REMOVED if value is None else value
    return values, tuple(refusals)


def rows(file: VehicleFile) -> list[SettingRow]:
    """Every setting of a file's processes with its value."""
    return [_row(setting, value) for setting, value in values_of(file, catalogue(file.role, file.processes)).items()]


def digests(file: VehicleFile) -> dict[str, str]:
    """Digest of what each process reads."""
    return {name: digest_for(name, file, file.section(name, section_of(name))) for name in file.processes}


def shown(value: object) -> str:
    """Value as JSON, without users and passwords of addresses."""
    return without_users(_plainly(value))[:VALUE]


def refusal(code: Code, **texts: str) -> Explanation:
    """Explain with quoted texts."""
    return explain(code, **{name: QuotedText(quoted=text[:QUOTED_LENGTH]) for name, text in texts.items()})


def _plainly(value: object) -> str:
    return json.dumps(value, ensure_ascii=False)


def _row(setting: Setting, value: object) -> SettingRow:
    return SettingRow(
        name=setting.name, kind=setting.kind, value=shown(value), default=shown(setting.default),
        bounds=setting.bounds, choices=setting.choices, meaning=setting.meaning[:MEANING],
    )  # fmt: skip


def _count(file: VehicleFile, earlier: str, path: str) -> int:
    try:
        return len(differences(parse_vehicle(earlier, path), file))
    except UserError:  # of another release: restoring it says what is wrong
        return len(list(settings_of(FACTS)))


def main() -> None:
    """Answer the question on standard input."""
    try:
        question = Question.model_validate_json(sys.stdin.buffer.read())
    except ValidationError as error:
        sys.exit(f"no question: {error}")
    sys.stdout.write(answer(question).model_dump_json())


if __name__ == "__main__":
    main()

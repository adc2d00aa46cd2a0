"""Settings of the unit: what holds, what is to be changed, and what has become of a change."""

from enum import StrEnum
from typing import Annotated

from pydantic import Field

from .base import Count, Message, Name, Nanoseconds
from .explanation import Explanation

SETTING = r"^[a-z][a-z0-9_]*(\.[a-z][a-z0-9_]*){1,5}$"
VALUE_LENGTH = 4000
CHANGES_MAXIMUM = 64
SettingName = Annotated[str, Field(pattern=SETTING, max_length=120)]
# As JSON; users and passwords in addresses are left out of what the unit states.
ValueText = Annotated[str, Field(max_length=VALUE_LENGTH)]
Digest = Annotated[str, Field(pattern=r"^[0-9a-f]{16}$")]


class SettingRow(Message):
    """One setting: what it is, its bounds, default and value."""

    name: SettingName
    kind: Annotated[str, Field(max_length=80)]  # JSON type, or types joined by " or "
    value: ValueText
    default: ValueText
    bounds: Annotated[tuple[Annotated[str, Field(max_length=80)], ...], Field(max_length=8)] = ()
    choices: Annotated[tuple[Annotated[str, Field(max_length=80)], ...], Field(max_length=64)] = ()
    meaning: Annotated[str, Field(max_length=600)] = ""


class SettingsCatalogue(Message):
    """Every setting of the processes of this unit."""

    sampled_ns: Nanoseconds
    settings: Annotated[tuple[SettingRow, ...], Field(max_length=1000)]


class SettingDifference(Message):
    """A setting whose value changes."""

    name: SettingName
    before: ValueText
    after: ValueText


class SettingsVersion(Message):
    """An earlier text of the settings, and how many of them differ from the present ones."""

    number: Count  # 1: the newest
    replaced_ns: Nanoseconds
    differing: Count | None = None  # not known of a text that cannot be read


class SettingsStage(StrEnum):
    """How far a change has come."""

    CHECKED = "checked"  # what it would change; nothing is written
    REFUSED = "refused"
    WATCHED = "watched"  # written; the processes that it touches are compared with what they were
    KEPT = "kept"
    TAKEN_BACK = "taken_back"


class SettingsChange(Message):
    """A change of the settings, and what has become of it."""

    request_id: Name
    by: Name  # the login that asked
    stage: SettingsStage
    begun_ns: Nanoseconds
    until_ns: Nanoseconds | None = None  # while watched: when it is decided
    confirmation: bool = False  # it is taken back unless it is confirmed until then
    offered: bool = False  # it is kept, and whether it is better shows in the next drive: taking it back is offered
    differences: Annotated[tuple[SettingDifference, ...], Field(max_length=CHANGES_MAXIMUM)] = ()
    touched: Annotated[tuple[Name, ...], Field(max_length=64)] = ()  # processes that start again
    reasons: Annotated[tuple[Explanation, ...], Field(max_length=16)] = ()  # of a refusal, or of taking it back


class SettingsState(Message):
    """Digests of the settings that hold, and the newest change."""

    sampled_ns: Nanoseconds
    digests: Annotated[dict[Name, Digest], Field(max_length=64)]  # of each process
    change: SettingsChange | None = None
    versions: Annotated[tuple[SettingsVersion, ...], Field(max_length=10)] = ()
    changed: bool = False  # the vehicle's file does not hold: another text was written over it
    problem: Explanation | None = None  # why the settings cannot be changed, or what was noticed


class SettingsAction(StrEnum):
    """What is asked of `controller.settings`."""

    CHECK = "check"
    APPLY = "apply"
    CONFIRM = "confirm"  # of a watched change, through the way that it leads to
    TAKE_BACK = "take_back"  # the newest change
    RESTORE = "restore"  # an earlier text


class SettingsCommand(Message):
    """Settings to be checked or changed."""

    request_id: Name
    action: SettingsAction
    by: Name = "unknown"
    changes: Annotated[dict[Name, ValueText | None], Field(max_length=CHANGES_MAXIMUM)] = Field(
        default_factory=dict
    )  # value as JSON; None: the default
    version: Count | None = None  # of RESTORE; 1: the newest


class SettingsAnswer(Message):
    """What a command would change, or why it is refused."""

    sampled_ns: Nanoseconds
    change: SettingsChange

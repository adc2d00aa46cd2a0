"""Question and answer of `shared/settings/check.py`, for who asks without its weight."""

from typing import Annotated

from pydantic import BaseModel, Field

from ..messages.explanation import Explanation
from ..messages.settings import SettingDifference, SettingRow


class Question(BaseModel):
    """The text that holds, the texts before it, and what it is to become."""

    path: str  # of the vehicle's file
    text: str
    earlier: tuple[str, ...] = ()  # newest first
    changes: dict[str, str | None] = {}  # values as JSON; None: the default
    replacement: str | None = None  # another text, in the place of changes


class Answer(BaseModel):
    """What would hold: its text, and for each process the digest of what it reads; or why that cannot be."""

    text: str = ""
    refusals: tuple[Explanation, ...] = ()
    differences: tuple[SettingDifference, ...] = ()
    touched: tuple[str, ...] = ()
    digests: dict[str, str] = {}
    settings: tuple[SettingRow, ...] = ()
    counts: tuple[Annotated[int, Field(ge=0)] | None, ...] = ()  # of settings that earlier texts have otherwise

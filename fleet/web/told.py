"""What vehicles and alarms say by codes, in every language; what has no words is shown by its own text, uncut."""

import json
from collections.abc import Mapping
from typing import Any

from pydantic import ValidationError

from fleet.alarms.codes import code_of
from shared.messages.explanation import Explanation
from shared.words.words import LANGUAGES, CodedText, Words, words

from .database import Row

LISTED = 64  # reasons of an event, which is anybody's


def with_languages(row: Row) -> Row:
    """Add to an event the texts of its content that have codes, by language."""
    content = row.get("content")
    if not isinstance(content, Mapping):
        return row
    return {**row, "languages": {language: _texts(content, words(language)) for language in LANGUAGES}}


def alarm_with_languages(row: Row) -> Row:
    """Add to an alarm its code, and what that says by language."""
    code = code_of(str(row["kind"]), row["detail"])
    if code is None:
        return {**row, "code": None, "languages": {}}
    said = {language: {"sentence": text} for language in LANGUAGES if (text := words(language).detail(code))}
    return {**row, "code": code.model_dump(mode="json"), "languages": said}


def _texts(content: Mapping[str, Any], spoken: Words) -> dict[str, object]:
    found: dict[str, object] = {}
    reasons, codes = content.get("reasons"), content.get("reason_codes")
    if isinstance(reasons, list) and isinstance(codes, list):
        told = [_told(text, code, spoken) for text, code in zip(reasons[:LISTED], codes, strict=False)]
        found["reasons"] = [*told, *reasons[len(told) :]]
    for field in ("cause", "reason"):
        if field in content and f"{field}_code" in content:
            found[field] = _told(content[field], content[f"{field}_code"], spoken)
    monitors = content.get("monitors")
    if isinstance(monitors, list):
        found["monitors"] = [
            {**monitor, "reason": _told(monitor.get("reason"), monitor.get("reason_code"), spoken)}
            if isinstance(monitor, Mapping) else monitor
            for monitor in monitors[:LISTED]
        ]  # fmt: skip
    return found


def _told(text: object, code: object, spoken: Words) -> object:
    """What a code says; the text of the message where it is none, or has no words."""
    try:
        explanation = Explanation.model_validate_json(json.dumps(code))
    except (ValidationError, RecursionError):
        return text
    return spoken.told(CodedText(text if isinstance(text, str) else "", explanation)) or text

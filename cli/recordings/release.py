"""Which release has made a recording, and whether it is the one that runs: only that can repeat it byte for byte."""

import json
from dataclasses import dataclass

from shared import VERSION
from shared.recording import Recording
from shared.recording.channels import schema_of

FIRST = "0.1.0"  # recordings do not state versions before
DESCRIPTIVE_KEYS = frozenset({"description", "title"})  # parts of a schema that describe and decide nothing


@dataclass(frozen=True)
class Release:
    """The version that a recording states, and the topics whose messages have another schema now."""

    version: str  # empty: it states none
    changed: tuple[str, ...] = ()

    @property
    def is_this(self) -> bool:
        """Whether it is, as far as the recording says, the release that runs."""
        return self.version == VERSION and not self.changed

    @property
    def name(self) -> str:
        """The release, for people."""
        if self.version == VERSION:
            return f"a build of version {VERSION} with other messages ({', '.join(self.changed[:3])})"
        return f"version {self.version[:32]}" if self.version else f"version {FIRST} or earlier"


def release_of(recording: Recording) -> Release:
    """Find the release of a recording; schemas are compared where its summary has them."""
    changed = []
    for topic, schema in sorted(recording.schemas().items()):
        known = schema_of(topic)
        if known is not None and _decisive(schema) != _decisive(known[1]):
            changed.append(topic)
    return Release(recording.metadata.get("obu", {}).get("version", ""), tuple(changed))


def _decisive(schema: bytes) -> object:
    """A schema without descriptions; None for one that is no JSON."""
    try:
        return _without_descriptions(json.loads(schema))
    except (ValueError, RecursionError):
        return None


def _without_descriptions(value: object, *, of_names: bool = False) -> object:
    if isinstance(value, dict):
        kept = (
            value.items() if of_names else ((key, item) for key, item in value.items() if key not in DESCRIPTIVE_KEYS)
        )
        return {key: _without_descriptions(item, of_names=key in ("properties", "$defs")) for key, item in kept}
    return [_without_descriptions(item) for item in value] if isinstance(value, list) else value

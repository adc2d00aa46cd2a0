"""Differences between two snapshots, so that a browser is sent only what changed.

Objects merge, everything else is replaced. Nothing is ever removed: what is gone becomes null.
"""

from collections.abc import Mapping
from typing import cast

Json = Mapping[str, object]


def difference(old: Json, new: Json) -> dict[str, object]:
    """List what must be merged into `old` to make `new`."""
    changes: dict[str, object] = {key: None for key in old if key not in new and old[key] is not None}
    for key, value in new.items():
        before = old.get(key)
        if isinstance(value, Mapping) and isinstance(before, Mapping):
            if inner := difference(cast(Json, before), cast(Json, value)):
                changes[key] = inner
        elif value != before or key not in old:
            changes[key] = value
    return changes


def merge(old: Json, changes: Json) -> dict[str, object]:
    """Apply a difference, as the browser does."""
    merged = dict(old)
    for key, value in changes.items():
        before = merged.get(key)
        if isinstance(value, Mapping) and isinstance(before, Mapping):
            merged[key] = merge(cast(Json, before), cast(Json, value))
        else:
            merged[key] = value
    return merged

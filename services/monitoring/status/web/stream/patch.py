"""Differences between two snapshots, so that a browser is sent only what changed.

Objects merge, everything else is replaced. Keys that are gone are named apart: a key that holds null stays a key, so
that a page which follows the differences knows what one that has just received a snapshot knows.
"""

from collections.abc import Mapping
from typing import NamedTuple, cast

Json = Mapping[str, object]
KeyPath = tuple[str, ...]  # keys from the outermost object to the one that is gone


class Difference(NamedTuple):
    """What makes one state of another; dashboard/store.js applies the same."""

    changed: Json  # objects merge, everything else replaces
    removed: tuple[KeyPath, ...] = ()  # keys to delete, none of which is in `changed`


def difference(old: Json, new: Json) -> Difference:
    """List what makes `new` of `old`."""
    removed: list[KeyPath] = []
    return Difference(_changes(old, new, (), removed), tuple(removed))


def merge(old: Json, change: Difference) -> dict[str, object]:
    """Apply a difference, as the browser does; raises KeyError for one that deletes what is not there."""
    merged = dict(old)
    for key, value in change.changed.items():
        before = merged.get(key)
        if isinstance(value, Mapping) and isinstance(before, Mapping):
            merged[key] = merge(cast(Json, before), Difference(cast(Json, value)))
        else:
            merged[key] = value
    for key, *rest in change.removed:
        if rest:
            merged[key] = merge(cast(Json, merged[key]), Difference({}, (tuple(rest),)))
        else:
            del merged[key]
    return merged


def _changes(old: Json, new: Json, at: KeyPath, removed: list[KeyPath]) -> dict[str, object]:
    changes: dict[str, object] = {}
    removed.extend((*at, key) for key in old if key not in new)
    for key, value in new.items():
        before = old.get(key)
        if isinstance(value, Mapping) and isinstance(before, Mapping):
            if inner := _changes(cast(Json, before), cast(Json, value), (*at, key), removed):
                changes[key] = inner
        elif value != before or key not in old or not _alike(before, value):
            changes[key] = value
    return changes


def _alike(one: object, other: object) -> bool:
    """Whether two equal values are the same as JSON, where True is not 1."""
    kind = type(one)
    if kind is list or kind is tuple:
        return all(map(_alike, cast("list[object]", one), cast("list[object]", other)))
    if kind is dict:
        return all(_alike(value, cast(Json, other)[key]) for key, value in cast(Json, one).items())
    return (kind is bool) is (type(other) is bool)

"""States of a unit as trees of JSON, for properties of differences between them."""

import json

from hypothesis import strategies as st

Tree = dict[str, object]
# Names that mean something to an object of JavaScript are among the keys; few, so that two trees share some.
KEYS = st.sampled_from(("a", "b", "c", "0", "", "__proto__", "constructor", "toString"))
LEAVES = st.none() | st.booleans() | st.integers(-2, 2) | st.text(max_size=3) | st.lists(st.integers(0, 1), max_size=2)
trees = st.recursive(
    st.dictionaries(KEYS, LEAVES, max_size=4), lambda inner: st.dictionaries(KEYS, LEAVES | inner, max_size=4),
    max_leaves=12,
)  # fmt: skip


def as_json(tree: object) -> str:
    """Write a tree so that equal text is the same JSON: keys in order, and true is not 1."""
    return json.dumps(tree, sort_keys=True)

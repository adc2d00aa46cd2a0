from hypothesis import given
from hypothesis import strategies as st

from services.monitoring.status.web.stream.patch import difference, merge

leaves = st.none() | st.booleans() | st.integers() | st.text(max_size=3) | st.lists(st.integers(), max_size=2)
trees = st.recursive(
    st.dictionaries(st.sampled_from("abcd"), leaves, max_size=4),
    lambda inner: st.dictionaries(st.sampled_from("abcd"), leaves | inner, max_size=4),
    max_leaves=12,
)


def present(value: object) -> object:
    """What is there: a key that holds null says the same as no key."""
    if not isinstance(value, dict):
        return value
    return {key: present(inner) for key, inner in value.items() if inner is not None}


@given(trees, trees)
def test_a_browser_that_merges_the_difference_knows_the_new_state(
    old: dict[str, object], new: dict[str, object]
) -> None:
    assert present(merge(old, difference(old, new))) == present(new)


@given(trees)
def test_nothing_changed_is_nothing_to_say(tree: dict[str, object]) -> None:
    assert difference(tree, tree) == {}


def test_only_what_changed_is_sent() -> None:
    old = {"fix": {"latitude": 1, "longitude": 2}, "list": [1, 2], "gone": 3}
    new = {"fix": {"latitude": 1, "longitude": 5}, "list": [1, 3]}
    assert difference(old, new) == {"gone": None, "fix": {"longitude": 5}, "list": [1, 3]}

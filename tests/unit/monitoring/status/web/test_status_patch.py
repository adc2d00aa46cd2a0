from hypothesis import given

from services.monitoring.status.web.stream.patch import Difference, difference, merge
from tests.support.dashboard.snapshots import Tree, as_json, trees


@given(trees, trees)
def test_a_merged_difference_gives_the_new_state_nulls_included(old: Tree, new: Tree) -> None:
    before = as_json(old)
    assert as_json(merge(old, difference(old, new))) == as_json(new)
    assert as_json(old) == before, "a snapshot that others were sent is not changed"


@given(trees)
def test_nothing_changed_is_nothing_to_send(tree: Tree) -> None:
    assert difference(tree, tree) == Difference({}, ())


def test_only_what_changed_is_sent_and_what_is_gone_is_named() -> None:
    old = {"fix": {"latitude": 1, "longitude": 2}, "list": [1, 2], "gone": 3, "null": 4, "kept": None}
    new = {"fix": {"longitude": 5}, "list": [1, 3], "null": None, "kept": None}
    changed = {"fix": {"longitude": 5}, "list": [1, 3], "null": None}
    assert difference(old, new) == Difference(changed, (("gone",), ("fix", "latitude")))


def test_a_truth_value_that_becomes_a_number_is_a_change() -> None:
    assert difference({"x": True, "y": [0]}, {"x": 1, "y": [False]}).changed == {"x": 1, "y": [False]}

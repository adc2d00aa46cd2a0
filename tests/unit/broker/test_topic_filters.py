"""Filters against paho's own matcher, and against all topics of a small set."""

import itertools

import pytest
from hypothesis import given
from hypothesis import strategies as st
from paho.mqtt.client import topic_matches_sub

from broker.simulated.topic_filters import is_filter, is_name, matches, overlap
from tests.support.cases import each

names = st.lists(st.sampled_from(["a", "b", "", "$x"]), min_size=1, max_size=5).map("/".join).filter(bool)
filters = (
    st.tuples(
        st.lists(st.sampled_from(["a", "b", "", "+", "$x"]), max_size=4), st.sampled_from(["a", "", "+", "#", "$x"])
    )
    .map(lambda parts: "/".join([*parts[0], parts[1]]))
    .filter(bool)
)
EVERY_NAME = [
    name
    for depth in range(1, 5)
    for levels in itertools.product(("a", "b", ""), repeat=depth)
    if (name := "/".join(levels))
]
SMALL_FILTERS = [
    "/".join(levels)
    for depth in range(1, 4)
    for levels in itertools.product(("a", "b", "+", "#"), repeat=depth)
    if "#" not in levels[:-1]
]


@given(filters, names)
def test_a_filter_matches_the_topics_that_paho_matches(pattern: str, topic: str) -> None:
    assert matches(pattern, topic) == topic_matches_sub(pattern, topic)


def test_two_filters_overlap_if_a_topic_matches_both() -> None:
    taken = {pattern: {name for name in EVERY_NAME if matches(pattern, name)} for pattern in SMALL_FILTERS}
    for item, other in itertools.product(SMALL_FILTERS, repeat=2):
        assert overlap(item, other) == bool(taken[item] & taken[other]), (item, other)


@each("pattern", ["#", "+", "a", "/", "a/#", "+/+", "a/+/b", "$SYS/#", "a//b"])
def test_valid_filters_are_accepted(pattern: str) -> None:
    assert is_filter(pattern)


@pytest.mark.parametrize("pattern", ["", "a#", "#/a", "a/#/b", "a+", "+a/b", "a/b+"])
def test_invalid_filters_are_rejected(pattern: str) -> None:
    assert not is_filter(pattern)


@given(filters)
def test_a_topic_name_is_a_filter_without_wildcards(pattern: str) -> None:
    assert is_name(pattern) == (is_filter(pattern) and not {"+", "#"} & set(pattern.split("/")))


@pytest.mark.parametrize(("levels", "accepted"), [(200, True), (201, False)])
def test_topics_with_too_many_levels_are_rejected(levels: int, accepted: bool) -> None:
    topic = "/".join(["a"] * levels)
    assert is_name(topic) is accepted
    assert is_filter(topic) is accepted

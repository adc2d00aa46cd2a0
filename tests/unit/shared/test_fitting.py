"""A list is divided among messages that the broker passes on."""

from itertools import zip_longest

from hypothesis import given
from hypothesis import strategies as st

from shared.bus.codec import encode
from shared.messages.fitting import fitting, parts
from shared.messages.replay import TrustChange

changes = st.lists(st.builds(TrustChange, since_ns=st.integers(0, 10**18), state=st.text(max_size=20)), max_size=30)


@given(changes, st.integers(1, 2_000))
def test_parts_hold_every_item_in_order_and_as_many_as_fit(items: list[TrustChange], most_bytes: int) -> None:
    found = list(parts(items, most_bytes))
    assert [item for part in found for item in part] == items
    for part, following in zip_longest(found, found[1:], fillvalue=()):
        size = sum(len(encode(item)) + 1 for item in part)
        assert size <= most_bytes or len(part) == 1
        assert not following or size + len(encode(following[0])) + 1 > most_bytes


@given(changes, st.integers(0, 2_000))
def test_what_fits_is_the_beginning_of_the_list(items: list[TrustChange], most_bytes: int) -> None:
    found = list(fitting(items, most_bytes))
    assert found == items[: len(found)]
    assert sum(len(encode(item)) + 1 for item in found) <= most_bytes

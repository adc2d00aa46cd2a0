import pytest
from hypothesis import given
from hypothesis import strategies as st

from shared.messages.v2x import MAX_FRAME_BYTES
from shared.v2x import frames

records = st.lists(st.tuples(st.integers(-(2**63), 2**63 - 1), st.binary(max_size=200)), max_size=20)


@given(records)
def test_a_batch_is_split_into_the_frames_that_it_was_made_of(batch: list[tuple[int, bytes]]) -> None:
    assert list(frames.unpack(frames.pack(batch))) == batch


@given(records.filter(bool), st.data())
def test_the_frames_before_a_truncated_record_are_found(batch: list[tuple[int, bytes]], data: st.DataObject) -> None:
    packed = frames.pack(batch)
    found = []
    cut = data.draw(st.integers(1, len(packed) - 1))
    try:
        for record in frames.unpack(packed[:cut]):
            found.append(record)
    except ValueError:
        assert len(found) < len(batch)
    assert found == batch[: len(found)]


def test_a_record_that_is_longer_than_a_frame_is_rejected() -> None:
    assert len(list(frames.unpack(frames.pack([(0, bytes(MAX_FRAME_BYTES))])))) == 1
    with pytest.raises(ValueError, match="too long"):
        list(frames.unpack(frames.pack([(0, bytes(MAX_FRAME_BYTES + 1))])))

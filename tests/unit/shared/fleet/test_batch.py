import random
import zlib
from dataclasses import replace
from typing import Any

import pytest
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PublicKey
from hypothesis import given
from hypothesis import strategies as st

from shared.evidence.signer import FileSigner
from shared.fleet.batch import (
    EARLIEST_MS,
    LATEST_MS,
    MAX_SEQUENCE,
    VERDICTS,
    BadBatch,
    Batch,
    Event,
    Gap,
    Kind,
    Report,
    decode,
    encode,
    verdict_code,
)
from shared.fleet.cbor import BadCbor, encoded
from shared.fleet.receipts import Receipt, RejectedBatch, StoredBatch
from shared.fleet.sealed import chain_digest, receipt_digest, seal, unsealed
from shared.messages.trust import TrustLevel
from tests.support.cases import each

SIGNER = FileSigner(bytes(range(32)))
KEY = Ed25519PublicKey.from_public_bytes(SIGNER.public_key)
START_MS = 1_796_000_000_000
ZEROS = bytes(32)

times = st.integers(EARLIEST_MS, LATEST_MS)
places = st.tuples(
    st.integers(-900_000_000, 900_000_000), st.integers(-1_800_000_000, 1_800_000_000),
    st.integers(-10_000_000, 10_000_000), st.integers(-100_000, 100_000), st.integers(-100_000, 100_000),
)  # fmt: skip
reports = st.builds(
    lambda at, place, level, verdict: Report._make((at, *(place or (None,) * 5), level, verdict)),
    times, st.none() | places, st.none() | st.integers(0, 10_000_000), st.integers(0, 5),
)  # fmt: skip
texts = st.text(st.characters(exclude_characters="\0", exclude_categories=["Cs"]), max_size=20)
plain = st.recursive(
    st.none() | st.booleans() | st.integers(-(2**63), 2**63) | st.floats(allow_nan=False, allow_infinity=False) | texts,
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(texts, inner, max_size=4),
    max_leaves=20,
)
events = st.builds(Event, times, st.just("trust/event"), st.dictionaries(texts, plain, max_size=5))


def drive(count: int, seed: int = 1) -> tuple[Report, ...]:
    noise = random.Random(seed)
    latitude, longitude, found = 481_351_240, 115_819_820, []
    for second in range(count):
        north, east = round(noise.gauss(1000, 30)), round(noise.gauss(800, 30))
        latitude, longitude = latitude + round(north * 0.898), longitude + round(east * 1.34)
        at = START_MS + 1000 * second + noise.randint(-3, 3)
        found.append(Report(at, latitude, longitude, 52_000 + noise.randint(-30, 30), north, east, 35, 0))
    return tuple(found)


def positions(found: tuple[Report, ...], first: int = 0) -> Batch:
    return Batch(Kind.POSITIONS, START_MS, first, len(found), ZEROS, reports=found)


@given(st.lists(reports, min_size=1, max_size=30).map(tuple), st.integers(0, MAX_SEQUENCE - 30))
def test_positions_come_back_as_they_were(found: tuple[Report, ...], first: int) -> None:
    assert decode(encode(positions(found, first))) == positions(found, first)


@given(st.lists(events, min_size=1, max_size=5).map(tuple))
def test_events_come_back_as_they_were(found: tuple[Event, ...]) -> None:
    batch = Batch(Kind.EVENTS, START_MS, 5, len(found), ZEROS, events=found)
    assert decode(encode(batch)) == batch


def test_a_gap_comes_back_as_it_was_and_may_stand_for_any_number() -> None:
    batch = Batch(Kind.GAP, START_MS, 0, 10_000_000, ZEROS, gap=Gap(START_MS, START_MS + 1, b"x" * 32))
    assert decode(encode(batch)) == batch
    assert batch.span_ms == (START_MS, START_MS + 1)


def test_ten_reports_of_a_drive_take_less_than_thirty_bytes_each_with_their_signature() -> None:
    assert len(seal(positions(drive(10)), SIGNER, "car-1")) <= 300


@given(st.binary(max_size=400))
def test_bytes_of_anybody_are_a_batch_or_refused(data: bytes) -> None:
    for bytes_ in (data, zlib.compress(data)):
        with pytest.raises(BadBatch):
            decode(bytes_)
    with pytest.raises(BadBatch):
        unsealed(b"\xd2" + data)


GOOD: list[Any] = [1, 0, START_MS, 0, 1, ZEROS, [[START_MS], [1], [2], [3], [4], [5], [6], [0]], []]


@each(
    ("place", "value"),
    [
        (0, 2), (1, 3), (1, -1), (2, 5), (2, LATEST_MS + 1), (3, -1), (3, MAX_SEQUENCE), (4, 0), (4, 2), (4, -1),
        (5, b""), (6, []), (6, [[START_MS]] * 7), (7, [[START_MS, "trust/event", {}]]), (0, "1"), (6, 5), (7, None),
        (1, 1), (1, 2), (2, 1e12), (0, True), (1, False), (3, False), (4, True),
    ],
)  # fmt: skip
def test_a_field_that_cannot_be_is_refused(place: int, value: object) -> None:
    decode(zlib.compress(encoded(GOOD)))
    bad = [value if number == place else field for number, field in enumerate(GOOD)]
    with pytest.raises(BadBatch):
        decode(zlib.compress(encoded(bad)))


@each(
    ("column", "values"),
    [
        (0, [None]), (0, [EARLIEST_MS - 1]), (0, [LATEST_MS + 1]), (0, [1.5]), (0, [True]), (1, [900_000_001]),
        (2, [-1_800_000_001]), (3, [10_000_001]), (4, [100_001]), (5, ["5"]), (6, [-1]), (7, [6]), (7, [-1]),
        (7, [None]), (1, [None]), (5, [None]), (3, []), (3, 7), (3, [1, 2]),
    ],
)  # fmt: skip
def test_a_column_that_cannot_be_is_refused(column: int, values: object) -> None:
    columns = [values if number == column else item for number, item in enumerate(GOOD[6])]
    with pytest.raises(BadBatch):
        decode(zlib.compress(encoded([*GOOD[:6], columns, []])))


@each(
    "row",
    [
        [START_MS, "trust", {}], [START_MS, "trust/event\n", {}], [0, "trust/event", {}], [START_MS, "trust/event", []],
        [START_MS, "trust/event", {"a": "\0"}], [START_MS, "trust/event", {"\0": 1}], [START_MS, "trust/event", {1: 2}],
        [START_MS, "trust/event", {"a": float("nan")}], [START_MS, "trust/event", {"a": [float("inf")]}],
        [START_MS, "trust/event", {"a": b"bytes"}], [START_MS, "trust/event", {"a": "x" * 20_000}],
        [START_MS, "trust/event", {"a": [0] * 5000}], [START_MS, "trust/event"],
    ],
)  # fmt: skip
def test_an_event_that_a_database_cannot_hold_is_refused(row: list[object]) -> None:
    with pytest.raises(BadBatch):
        decode(zlib.compress(encoded([1, 1, START_MS, 0, 1, ZEROS, [], [row]])))


def test_a_batch_that_unpacks_to_far_more_than_it_may_is_refused() -> None:
    with pytest.raises(BadBatch):
        decode(zlib.compress(bytes(100_000_000)))


def test_what_the_centre_would_refuse_is_not_sent() -> None:
    with pytest.raises(BadBatch):
        encode(positions((drive(1)[0]._replace(latitude_e7=None),)))
    with pytest.raises(BadBatch):
        encode(positions(drive(601)))


def test_a_seal_is_that_of_its_vehicle_and_key_and_of_every_byte() -> None:
    data = seal(positions(drive(3)), SIGNER, "car-1")
    read = unsealed(data)
    assert read.is_genuine(KEY, "car-1")
    assert not read.is_genuine(KEY, "car-2")
    assert read.key == SIGNER.key_id
    assert read.batch == positions(drive(3))
    assert receipt_digest(data) == chain_digest(data)[:8]
    for place in range(len(data)):
        changed = data[:place] + bytes([data[place] ^ 1]) + data[place + 1 :]
        try:
            genuine = unsealed(changed).is_genuine(KEY, "car-1")
        except BadBatch:
            continue
        assert not genuine, f"byte {place}"


def test_a_signature_of_the_same_batch_has_the_same_bytes() -> None:
    batch = positions(drive(3))
    assert seal(batch, SIGNER, "car-1") == seal(batch, SIGNER, "car-1")
    assert seal(replace(batch, first=1), SIGNER, "car-1") != seal(batch, SIGNER, "car-1")


def test_the_worst_verdict_is_the_greatest_code_and_each_has_one() -> None:
    assert set(VERDICTS) == set(TrustLevel)
    assert max(map(verdict_code, TrustLevel)) == verdict_code(TrustLevel.UNSAFE)
    assert min(map(verdict_code, TrustLevel)) == verdict_code(TrustLevel.SAFE)


def test_a_receipt_comes_back_as_it_was() -> None:
    receipt = Receipt(
        (StoredBatch(START_MS, 0, b"12345678"),), (RejectedBatch(START_MS, 10, b"87654321", "signature"),)
    )
    assert Receipt.decode(receipt.encode()) == receipt


@each(
    "content",
    [
        [], {}, {"stored": []}, {"stored": [], "refused": [], "more": 1}, {"stored": [[1, 2]], "refused": []},
        {"stored": [[1, 2, b"short"]], "refused": []}, {"stored": [[-1, 2, b"12345678"]], "refused": []},
        {"stored": [], "refused": [[1, 2, b"12345678", "unknown"]]},
        {"stored": [[1, 2, b"12345678"]] * 257, "refused": []},
    ],
)  # fmt: skip
def test_what_is_no_receipt_is_refused(content: object) -> None:
    with pytest.raises(BadCbor):
        Receipt.decode(encoded(content))

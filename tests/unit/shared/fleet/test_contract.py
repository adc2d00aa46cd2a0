"""The printed contract agrees with what the codec makes."""

import zlib
from typing import Any

from jsonschema import Draft202012Validator

from shared.fleet.batch import Batch, Event, Gap, Kind, Report, encode
from shared.fleet.cbor import decoded
from shared.fleet.contract import asyncapi
from shared.fleet.receipts import Receipt, RejectedBatch, StoredBatch

AT_MS = 1_796_000_000_000
BINARY = "0" * 32  # JSON Schema knows no bytes


def schema(message: str) -> Draft202012Validator:
    components: Any = asyncapi()["components"]
    found = components["messages"][message]["payload"]["schema"]
    Draft202012Validator.check_schema(found)
    return Draft202012Validator(found)


def as_json(value: object) -> object:
    if isinstance(value, bytes):
        return BINARY
    if isinstance(value, list):
        return [as_json(item) for item in value]
    return {name: as_json(item) for name, item in value.items()} if isinstance(value, dict) else value


def test_every_kind_of_batch_is_as_the_contract_says() -> None:
    reports = (
        Report(AT_MS, 481_000_000, 115_000_000, 50_000, 1000, -5, None, 0),
        Report._make((AT_MS + 1000, *[None] * 6, 5)),
    )
    events = (Event(AT_MS, "trust/event", {"state": "unsafe"}),)
    for batch in (
        Batch(Kind.POSITIONS, AT_MS, 0, 2, bytes(32), reports=reports),
        Batch(Kind.EVENTS, AT_MS, 2, 1, bytes(32), events=events),
        Batch(Kind.GAP, AT_MS, 3, 1000, bytes(32), gap=Gap(AT_MS, AT_MS, bytes(32))),
    ):
        schema("Batch").validate(as_json(decoded(zlib.decompress(encode(batch)))))


def test_receipts_and_watches_are_as_the_contract_says() -> None:
    receipt = Receipt((StoredBatch(AT_MS, 0, bytes(8)),), (RejectedBatch(0, 0, bytes(8), "key"),))
    schema("Receipt").validate(as_json(decoded(receipt.encode())))
    schema("Watch").validate({"topics": ["navigation/solution"], "for_s": 30, "watchers": 1})
    assert not schema("Watch").is_valid({"topics": ["can/raw"], "for_s": 30, "watchers": 1})
    assert not schema("Batch").is_valid([1, 7])

"""Feeds hostile content to what reads the other end of the link between units and a centre: each reads or refuses it.

`python -m benchmarks.fuzz_fleet [READER ...] --seconds 60 --seed 1`. A sound message is spoilt within: a value is
exchanged for one that no honest end sends, and the frames around it (CBOR, deflate, signature, JSON) are made anew, so
that it gets behind them; others are damaged as bytes. The address space is limited as for `fuzz_files`.
"""

import copy
import json
import random
import time
import zlib
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from math import inf
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any
from unittest.mock import patch

import cbor2
import psycopg
from cryptography import x509
from cryptography.hazmat.primitives import serialization
from pydantic import ValidationError

from fleet.admission.authority import Authority, BadRequest, key_of_request
from fleet.admission.enrolment import Enrolment, Refusal
from fleet.admission.process import EnrolRequest, RenewRequest
from fleet.ingest.verification import VerifiedBatch, last_position, newest
from services.monitoring.uplink.watching import BadWatch, Watch
from shared.errors import UserError
from shared.fleet import enrolling
from shared.fleet.batch import BadBatch, Kind
from shared.fleet.cbor import BadCbor
from shared.fleet.cose import sign1
from shared.fleet.identity import CENTRE, UplinkIdentity
from shared.fleet.receipts import Receipt, RejectedBatch, StoredBatch
from shared.fleet.sealed import unsealed
from tests.support.fleet.reports import Unit

from .fuzz import mutated
from .fuzz_files import failure_while, run

VEHICLE = "car-1"
UNIT = Unit(VEHICLE)
DEEP_CBOR, DEEP_JSON = 2000, 20_000
# What an honest end does not send, or not there.
VALUES: tuple[Callable[[], object], ...] = (
    *(lambda value=value: value for value in (
        None, True, False, 0, -1, 1, 1 << 31, (1 << 53) - 1, 1 << 53, (1 << 63) - 1, 1 << 63, -(1 << 63), (1 << 64) - 1,
        -(1 << 64), 253_402_300_800_000, -62_135_596_800_000, 900_000_001, 0.0, 1.5, -0.0, 1e308, 5e-324, float("nan"),
        float("inf"), "", "\0", "a\0b", "\N{GRINNING FACE}", "x" * 20_000, "uplink/gap", "9" * 5000, b"", bytes(8),
        bytes(32), bytes(70_000),
    )),
    lambda: [], lambda: {}, lambda: [0] * 5000, lambda: {str(number): number for number in range(5000)},
    lambda: {"\0": 1},
    lambda: _nested(8), lambda: _nested(40),
)  # fmt: skip


@dataclass(frozen=True)
class Reader:
    """What reads messages of the other end."""

    seeds: Sequence[object]  # sound content
    framed: Callable[[Any], bytes]  # puts content into a message
    read: Callable[[bytes], object]
    refusals: tuple[type[Exception], ...]  # that it may raise
    deep: bytes = b""  # a message of many levels, that no library encodes


def _nested(depth: int) -> object:
    content: object = 1
    for _ in range(depth):
        content = [content]
    return content


def spoilt(content: object, chance: random.Random) -> object:
    """The content with one to three values exchanged, doubled or left out."""
    found: Any = {"": copy.deepcopy(content)}
    for _ in range(chance.randrange(1, 4)):
        place, key = chance.choice(list(_places(found)))
        match chance.randrange(8):
            case 0 if isinstance(place, list):
                place.insert(key, copy.deepcopy(place[key]))
            case 1 if place is not found:
                del place[key]
            case 2 if isinstance(place[key], int) and not isinstance(place[key], bool):
                place[key] += chance.choice((-1, 1)) << chance.randrange(64)
            case _:
                place[key] = chance.choice(VALUES)()
    return found.get("")


def _places(content: Any) -> Iterator[tuple[Any, Any]]:
    """Each container of the content with each of its keys."""
    for key, value in content.items() if isinstance(content, dict) else enumerate(content):
        yield content, key
        if isinstance(value, dict | list):
            yield from _places(value)


def _batch(content: object) -> bytes:
    payload = zlib.compress(cbor2.dumps(content, canonical=True))
    return sign1(payload, UNIT.signer, bytes.fromhex(UNIT.signer.key_id), VEHICLE.encode())


def read_batch(data: bytes) -> VerifiedBatch:
    """Read a batch as ingest does, up to what the database is given."""
    found = VerifiedBatch(VEHICLE, 1, data, b"", unsealed(data).batch, None)
    _ = found.day, found.worst, found.stored
    if found.batch.kind is Kind.POSITIONS:
        newest(found.batch)
        last_position(found.batch)
    json.dumps([event.content for event in found.batch.events], allow_nan=False)
    return found


def batches() -> list[object]:
    """Content of a batch of each kind."""
    unit = Unit(VEHICLE)
    made = unit.positions((0, 0, 5)), unit.events("trust/event", "toll/transaction"), unit.gap(9, 30)
    return [cbor2.loads(zlib.decompress(unsealed(payload).message.payload)) for payload in made]


def _json(content: object) -> bytes:
    return json.dumps(content, default=lambda value: value.hex()).encode()


class _Admission:
    """Requests of a unit, and answers of the centre, as both ends read them; without a network."""

    def __init__(self, folder: Path) -> None:
        self.authority = Authority(folder / "authority")
        self.enrolment = Enrolment(self._no_database, self.authority, {})
        self.folder = folder / "uplink"
        self.spoil: Callable[[bytes], bytes] = bytes
        self.bodies: list[dict[str, Any]] = []
        with patch.object(enrolling, "_exchange", self._exchange):
            token = f"secret.{enrolling.fingerprint_of(self.authority.pem)}"
            self.identity = enrolling.enrol("https://centre.example", token, VEHICLE, self.folder, UNIT.signer)
            enrolling.renew(self.identity, UNIT.signer)
        self._sound = {path.name: path.read_bytes() for path in self.folder.iterdir()}

    @staticmethod
    def _no_database() -> psycopg.Connection:
        raise Refusal("it was believed")

    def _exchange(self, _place: object, _method: str, path: str, body: bytes | None, _: object) -> tuple[int, bytes]:
        if body is None:
            return 200, self.authority.pem.encode()
        given = json.loads(body)
        self.bodies.append(given)
        return 200, self.spoil(_json(self.answer(given["request"])))

    def answer(self, request: str) -> dict[str, object]:
        """Answer as the centre does."""
        return {
            "vehicle": VEHICLE, "tenant": "demo", "certificate": self.authority.certify(request, VEHICLE).pem,
            "authority": self.authority.pem, "host": "centre.example", "mqtt_port": 8883,
            "renew_url": "https://centre.example/renew",
        }  # fmt: skip

    def enrol(self, data: bytes) -> None:
        """Read a request of enrolment, and the request for a certificate in it though nobody has signed it."""
        body = EnrolRequest.model_validate_json(data)
        key_of_request(body.request)
        self.enrolment.enrol(**body.model_dump())

    def renew(self, data: bytes) -> None:
        """Read a request of renewal."""
        body = RenewRequest.model_validate_json(data)
        given = body.model_dump(exclude={"signature"})
        self.enrolment.renew(**given, signature=bytes.fromhex(body.signature))

    def read_answer(self, data: bytes) -> None:
        """Take what a centre has answered, as a unit does, and read what that has written."""
        self._restore()
        self.spoil = lambda sound: _merged(sound, data)
        with patch.object(enrolling, "_exchange", self._exchange):
            enrolling.renew(self.identity, UNIT.signer)
        UplinkIdentity.read(self.folder)

    def _restore(self) -> None:
        """Give the unit back its enrolment."""
        for name, content in self._sound.items():
            (self.folder / name).unlink()
            (self.folder / name).write_bytes(content)

    def read_certificate(self, data: bytes) -> None:
        """Read a certificate of anybody."""
        for kind in ("CERTIFICATE", "CERTIFICATE REQUEST"):
            text = f"-----BEGIN {kind}-----\n{_base64(data)}-----END {kind}-----\n"
            self.authority.issued(text)
            try:
                key_of_request(text)
            except BadRequest:
                continue

    def read_identity(self, data: bytes) -> None:
        """Read the enrolment as it is on the disk."""
        self._restore()
        (self.folder / CENTRE).write_bytes(data)
        UplinkIdentity.read(self.folder)


def _merged(sound: bytes, data: bytes) -> bytes:
    """An answer for this very request, as far as the spoilt one leaves the certificate as it was."""
    try:
        content, right = json.loads(data), json.loads(sound)
    except (ValueError, RecursionError):
        return data
    if isinstance(content, dict) and content.get("certificate") == "":
        content["certificate"] = right["certificate"]
    return _json(content)


def _base64(data: bytes) -> str:
    import base64

    return base64.encodebytes(data).decode()


@contextmanager
def readers() -> Iterator[dict[str, Reader]]:
    """All readers; some need a folder."""
    with TemporaryDirectory() as made:
        admission = _Admission(Path(made))
        enrol, renew = admission.bodies
        stored = (StoredBatch(1, 0, bytes(8)), StoredBatch(1, 1, bytes(8)))
        receipt = cbor2.loads(Receipt(stored, (RejectedBatch(0, 0, bytes(8), "key"),)).encode())
        watch = {"topics": ["gnss/fix"], "for_s": 30, "watchers": 1}
        certificate = x509.load_pem_x509_certificate(renew["certificate"].encode())
        request = x509.load_pem_x509_csr(enrol["request"].encode())
        der = [item.public_bytes(serialization.Encoding.DER) for item in (certificate, request)]
        deep_json = b"[" * DEEP_JSON
        refused = (ValidationError, Refusal, BadRequest)
        answer = {**admission.answer(enrol["request"]), "certificate": ""}
        identity = json.loads((admission.folder / CENTRE).read_bytes())
        yield {
            "batch": Reader(batches(), _batch, read_batch, (BadBatch,), b"\xd2" + b"\x81" * DEEP_CBOR),
            "receipt": Reader([receipt], lambda item: cbor2.dumps(item, canonical=True), Receipt.decode, (BadCbor,),
                              b"\x81" * DEEP_CBOR),
            "watch": Reader([watch], _json, lambda data: Watch().take(data, 0), (BadWatch,), b"[" * 4000),
            "enrol": Reader([enrol], _json, admission.enrol, refused, deep_json),
            "renew": Reader([renew], _json, admission.renew, refused, deep_json),
            "answer": Reader([answer], _json, admission.read_answer, (UserError,), deep_json),
            "identity": Reader([identity], _json, admission.read_identity, (UserError,), deep_json),
            "certificate": Reader(der, bytes, admission.read_certificate, ()),
        }  # fmt: skip


def message(reader: Reader, chance: random.Random) -> bytes:
    """A spoilt message."""
    seed = chance.choice(reader.seeds)
    if reader.deep and chance.random() < 0.01:
        return reader.deep
    if isinstance(seed, bytes) or chance.random() < 0.2:
        return mutated([reader.framed(seed)], chance)
    try:
        return reader.framed(spoilt(seed, chance))
    except (cbor2.CBORError, ValueError, TypeError):  # none that could be sent
        return b""


def fuzz(
    name: str, seed: int, seconds: float, folder: Path, least: int = 0, *, slowest_s: float = inf
) -> tuple[int, list[str]]:
    """Feed one reader for some seconds and `least` messages; return their number, and what failed."""
    chance, inputs, failures = random.Random(f"{name} {seed}"), 0, list[str]()
    with readers() as all_of:
        reader = all_of[name]
        until = time.monotonic() + seconds
        while inputs < least or time.monotonic() < until:
            data = message(reader, chance)
            if (failure := failure_while(partial(reader.read, data), reader.refusals, slowest_s)) is not None:
                folder.mkdir(parents=True, exist_ok=True)
                stored = folder / f"fleet-{name}-{seed}-{inputs}.bin"
                stored.write_bytes(data)
                failures.append(f"{name}: {failure}; input: {stored}")
            inputs += 1
    return inputs, failures


NAMES = ("batch", "receipt", "watch", "enrol", "renew", "answer", "identity", "certificate")


if __name__ == "__main__":
    run(__doc__, NAMES, fuzz, "messages")

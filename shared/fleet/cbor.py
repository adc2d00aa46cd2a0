"""CBOR (RFC 8949) of this protocol: arrays, maps, numbers, bytes and text in canonical form; no tags."""

from collections.abc import Callable, Mapping
from io import BytesIO
from typing import Any, cast

import cbor2

MAX_DEPTH = 12
# Tags that cbor2 turns into objects: dates, big numbers, patterns, shared references. Nothing of this protocol has one.
_TAGS = (0, 1, 2, 3, 4, 5, 25, 28, 29, 30, 35, 36, 37, 52, 54, 100, 256, 258, 260, 261, 1004, 43000, 55799)


class BadCbor(ValueError):
    """Bytes that are no CBOR of this protocol."""


def _refused(*_: object) -> object:
    raise ValueError("tags are not part of this protocol")


_DECODERS = cast("Mapping[int, Callable[[cbor2.CBORDecoder, bool], Any]]", dict.fromkeys(_TAGS, _refused))


def encoded(content: object) -> bytes:
    """Encode in canonical form: the same content gives the same bytes."""
    return cbor2.dumps(content, canonical=True)


def decoded(data: bytes, *, canonical: bool = True) -> object:
    """Decode one item that fills the bytes, and has their one form if that matters; raises `BadCbor`."""
    stream = BytesIO(data)
    try:
        content: object = cbor2.CBORDecoder(
            stream,
            semantic_decoders=_DECODERS,
            tag_hook=_refused,
            max_depth=MAX_DEPTH,
            allow_indefinite=False,
            allow_duplicate_keys=False,
        ).decode()
        whole = encoded(content) == data if canonical else stream.tell() == len(data)
    except (cbor2.CBORError, ValueError, TypeError, OverflowError) as error:
        raise BadCbor(f"no CBOR of this protocol: {error}") from error
    if not whole:
        raise BadCbor("CBOR that is not in canonical form, or is followed by other bytes")
    return content

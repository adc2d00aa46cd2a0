"""Statements: fields of text in one canonical form of bytes, which is what is signed."""

import json
from collections.abc import Mapping
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from .signer import Signer

SIGNATURE, KEY, PUBLIC_KEY = "signature", "key", "public_key"


def canonical(kind: str, fields: Mapping[str, str]) -> bytes:
    """Encode a statement: its kind, then all fields except the signature, sorted by name.

    The kind separates the statements from each other: a signature for one kind is invalid for every other one.
    """
    signed = {name: value for name, value in fields.items() if name != SIGNATURE}
    return f"obu {kind} 1\n".encode() + json.dumps(signed, sort_keys=True, separators=(",", ":")).encode()


def signed(kind: str, fields: Mapping[str, str], signer: "Signer") -> dict[str, str]:
    """Add the key and the signature to a statement; the fields are in the order of their names."""
    whole = {**fields, KEY: signer.key_id, PUBLIC_KEY: signer.public_key.hex()}
    return dict(sorted({**whole, SIGNATURE: signer.sign(canonical(kind, whole)).hex()}.items()))


def printable(text: object, length: int = 60) -> str:
    """Give text of a file that anybody may have written, for a terminal: no control characters, and not too much."""
    return "".join(letter if letter.isprintable() else "?" for letter in str(text)[:length])


def is_genuine(kind: str, fields: Mapping[str, str]) -> bool:
    """Whether the signature of a statement fits its content and the key that it names.

    That says nothing of whose key it is: anybody can make one. `KeyRing.accepts` says that.
    """
    from .signer import is_signature, key_id_of

    try:
        public, signature = bytes.fromhex(fields[PUBLIC_KEY]), bytes.fromhex(fields[SIGNATURE])
    except (KeyError, ValueError):
        return False
    if (fields[PUBLIC_KEY], fields[SIGNATURE]) != (public.hex(), signature.hex()):
        return False  # the same bytes in another spelling
    return fields.get(KEY) == key_id_of(public) and is_signature(public, signature, canonical(kind, fields))

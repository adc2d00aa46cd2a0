"""Public keys that a verifier accepts: the ring of a unit, or files that were given."""

import base64
import hashlib
import json
import os
import re
import secrets
from collections.abc import Iterable
from dataclasses import dataclass, replace
from pathlib import Path

# SubjectPublicKeyInfo of an Ed25519 key is this prefix and its 32 bytes (RFC 8410, section 4).
SPKI = bytes.fromhex("302a300506032b6570032100")
BEGIN, END = "-----BEGIN PUBLIC KEY-----", "-----END PUBLIC KEY-----"
PEM = re.compile(rf"{BEGIN}\s+([A-Za-z0-9+/=\s]+?)\s*{END}")
GRACE_NS = 86_400_000_000_000  # a file that was begun before a rotation ends with its key


@dataclass(frozen=True)
class PublicKey:
    """A public key, when it was made and, if another has replaced it, since when."""

    key_id: str
    public_key: bytes
    made_ns: int | None = None
    retired_ns: int | None = None

    def pem(self) -> str:
        """Encode it for other programs."""
        return "\n".join((BEGIN, base64.b64encode(SPKI + self.public_key).decode(), END, ""))


@dataclass(frozen=True)
class KeyRing:
    """Accepted public keys, the oldest first."""

    keys: tuple[PublicKey, ...] = ()

    def find(self, key_id: str) -> PublicKey | None:
        """Give a key by its name."""
        return next((key for key in self.keys if key.key_id == key_id), None)

    def accepts(self, key_id: str, public_key: str, begun_ns: int) -> bool:
        """Whether a key is in the ring, and what was begun at a time was not begun a day after its end.

        The time is what the signer says: who has a former key can still sign what claims to be older.
        """
        key = self.find(key_id)
        if key is None or key.public_key.hex() != public_key:
            return False
        return key.retired_ns is None or begun_ns <= key.retired_ns + GRACE_NS

    def with_key(self, key: PublicKey) -> "KeyRing":
        """Add a key."""
        return KeyRing((*self.keys, key))

    def retired(self, key_id: str, now_ns: int) -> "KeyRing":
        """Note when a key was replaced."""
        return KeyRing(tuple(replace(k, retired_ns=now_ns) if k.key_id == key_id else k for k in self.keys))

    @classmethod
    def read(cls, path: Path) -> "KeyRing":
        """Read a ring; empty where there is no file. Raises `OSError` and `ValueError`."""
        try:
            rows = json.loads(path.read_text(encoding="utf-8"))["keys"]
            found = [
                PublicKey(row["key"], bytes.fromhex(row["public_key"]), row.get("made_ns"), row.get("retired_ns"))
                for row in rows
            ]
        except FileNotFoundError:
            return cls()
        except (KeyError, TypeError, AttributeError) as error:
            raise ValueError("it is no ring of keys") from error
        for key in found:
            if key.key_id != _name(key.public_key):
                raise ValueError(f"key {key.key_id!r} has another name than its content")
        return cls(tuple(found))

    @classmethod
    def of_files(cls, paths: Iterable[Path]) -> "KeyRing":
        """Collect the public keys of PEM files and of rings; raises `OSError` and `ValueError`."""
        keys: list[PublicKey] = []
        for path in paths:
            text = path.read_text(encoding="utf-8")
            if text.lstrip().startswith("{"):
                keys += cls.read(path).keys
                continue
            found = [base64.b64decode("".join(body.split()), validate=True) for body in PEM.findall(text)]
            if not found or not all(len(payload) == len(SPKI) + 32 and payload.startswith(SPKI) for payload in found):
                raise ValueError(f"{path} holds no Ed25519 public key in PEM")
            keys += [PublicKey(_name(payload[len(SPKI) :]), payload[len(SPKI) :]) for payload in found]
        return cls(tuple(keys))

    def write(self, path: Path) -> None:
        """Write the ring in one piece; raises `OSError`."""
        rows = [
            {"key": k.key_id, "public_key": k.public_key.hex(), "made_ns": k.made_ns, "retired_ns": k.retired_ns}
            for k in self.keys
        ]
        draft = path.with_name(f".{path.name}.{os.getpid()}.{secrets.token_hex(4)}")
        with draft.open("w", encoding="utf-8") as file:
            json.dump({"keys": rows}, file, indent=1)
            file.flush()
            os.fsync(file.fileno())
        draft.replace(path)


def _name(public_key: bytes) -> str:
    return hashlib.sha256(public_key).hexdigest()[:16]

"""The evidence keys of vehicles, as far as they are asked for."""

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

from cryptography.exceptions import UnsupportedAlgorithm
from cryptography.hazmat.primitives.asymmetric.ec import SECP256R1, EllipticCurvePublicKey
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PublicKey

if TYPE_CHECKING:
    from shared.fleet.cose import PublicKey

FRESH_FOR_S = 30.0  # after which a key is asked for again: a message about a revocation may be lost
MAX_KEYS = 200_000
ED25519_BYTES = 32


class Limits(NamedTuple):
    """How much may be stored a day [MB], by the table `tenant`: of each vehicle, and of all of them together."""

    vehicle_mb: int = 50
    tenant_mb: int = 50_000


class KeyRow(NamedTuple):
    """An evidence key, as the database has it."""

    key_id: str
    vehicle: str
    tenant_id: int
    public_key: bytes  # 32 bytes of Ed25519, or the uncompressed point of P-256
    revoked: bool
    limits: Limits


@dataclass(frozen=True)
class Key:
    """An evidence key that can be verified with."""

    vehicle: str
    tenant_id: int
    public_key: "PublicKey | None"  # None: it cannot be read
    revoked: bool
    limits: Limits


class Keys:
    """Remembers keys for half a minute; one that is not there is asked for again, since an enrolment may come."""

    def __init__(self, ask: Callable[[list[str]], list[KeyRow]], now_s: Callable[[], float] = time.monotonic) -> None:
        self._ask, self._now_s = ask, now_s
        self._known: dict[str, tuple[float, Key]] = {}

    def load(self, key_ids: set[str]) -> None:
        """Ask the database for what is not known or old, in one question."""
        now = self._now_s()
        if len(self._known) > MAX_KEYS:
            self._known.clear()
        wanted = [key_id for key_id in key_ids if now - self._known.get(key_id, (-FRESH_FOR_S, None))[0] >= FRESH_FOR_S]
        if wanted:
            found = {row.key_id: row for row in self._ask(wanted)}
            for key_id in wanted:
                self._known.pop(key_id, None)
                if (row := found.get(key_id)) is not None:
                    key = Key(row.vehicle, row.tenant_id, public_key_of(row), row.revoked, row.limits)
                    self._known[key_id] = now, key

    def find(self, key_id: str) -> Key | None:
        """Give a key that was loaded; None: there is none of this name."""
        known = self._known.get(key_id)
        return None if known is None else known[1]

    def forget(self, key_id: str) -> None:
        """Ask again for a key, which was revoked."""
        self._known.pop(key_id, None)


def public_key_of(row: KeyRow) -> "PublicKey | None":
    """Read a public key of the database."""
    try:
        if len(row.public_key) == ED25519_BYTES:
            return Ed25519PublicKey.from_public_bytes(row.public_key)
        return EllipticCurvePublicKey.from_encoded_point(SECP256R1(), row.public_key)
    except (ValueError, UnsupportedAlgorithm):
        return None

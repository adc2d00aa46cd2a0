"""Keys and tokens of NATS: Ed25519 keys in base 32, and JWT that they sign (ADR-14 and ADR-26 of NATS)."""

import base64
import binascii
import json
import time
from collections.abc import Mapping

from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey

ACCOUNT = 0  # prefix byte of an account's public key: its text begins with A
HEADER = {"typ": "JWT", "alg": "ed25519-nkey"}


def now_s() -> int:
    """Time of day [s, UTC], as in claims."""
    return int(time.time())


class Issuer:
    """The account key that signs what the callout answers."""

    def __init__(self, secret: bytes) -> None:
        self._key = Ed25519PrivateKey.from_private_bytes(secret)
        self.public = nkey(ACCOUNT, self._key.public_key().public_bytes_raw())

    def token(self, subject: str, audience: str, content: Mapping[str, object], **claims: object) -> str:
        """Sign claims about a subject; `content` is NATS' own part."""
        body: dict[str, object] = {
            "iss": self.public, "sub": subject, "aud": audience, "iat": now_s(), "nats": dict(content), **claims,
        }  # fmt: skip
        signed = f"{_part(HEADER)}.{_part(body)}"
        return f"{signed}.{_base64(self._key.sign(signed.encode()))}"


def nkey(prefix: int, key: bytes) -> str:
    """Write a public key: prefix, key and CRC-16 (XMODEM), in base 32."""
    data = bytes([prefix]) + key
    return base64.b32encode(data + binascii.crc_hqx(data, 0).to_bytes(2, "little")).decode().rstrip("=")


def claims_of(token: str) -> dict[str, object]:
    """Read the claims of a token without verifying it: the server alone can publish one to the callout.

    Raises `ValueError` for what is no token.
    """
    parts = token.split(".")
    if len(parts) != 3:
        raise ValueError("no token")
    claims = json.loads(base64.urlsafe_b64decode(parts[1] + "=" * (-len(parts[1]) % 4)))
    if not isinstance(claims, dict):
        raise ValueError("no claims")
    return claims


def _part(content: Mapping[str, object]) -> str:
    return _base64(json.dumps(content, separators=(",", ":")).encode())


def _base64(data: bytes) -> str:
    return base64.urlsafe_b64encode(data).decode().rstrip("=")

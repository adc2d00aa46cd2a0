"""Mosquitto's password file: `name:$7$iterations$salt$hash`, by PBKDF2 with HMAC-SHA-512 (mosquitto_passwd of 2.0).

The secrets are random and 256 bits long, so that a guess fails at any number of iterations: Mosquitto's own default
of 101 keeps the broker's start short.
"""

import base64
import binascii
import hashlib
import hmac
import secrets
from collections.abc import Mapping

ITERATIONS = 101
MAX_ITERATIONS = 100_000  # of a file that is read: a password is computed while the broker serves nobody else
SALT_BYTES = 12
HASH_BYTES = 64
SCHEME = "7"


class PasswordsError(ValueError):
    """A line that is not understood."""


def line(name: str, secret: str) -> str:
    """Write the line of a user."""
    salt = secrets.token_bytes(SALT_BYTES)
    parts = ("", SCHEME, str(ITERATIONS), _text(salt), _text(_hash(secret, salt, ITERATIONS)))
    return f"{name}:{'$'.join(parts)}\n"


def password_file(secret_of: Mapping[str, str], before: str = "") -> str:
    """Write the file; a line of the file before that still holds is kept: the text changes with a secret only."""
    try:
        known = Passwords(before)
    except PasswordsError:
        known = Passwords("")
    return "".join(
        f"{name}:{known.lines[name]}\n" if known.matches(name, secret) else line(name, secret)
        for name, secret in secret_of.items()
    )


class Passwords:
    """The users of a password file; raises `PasswordsError` with the number of a line that is not understood."""

    def __init__(self, text: str) -> None:
        self.lines: dict[str, str] = {}
        self._entries: dict[str, tuple[int, bytes, bytes]] = {}
        for number, row in enumerate(text.splitlines(), 1):
            if row.strip():
                name, _, rest = row.strip().partition(":")
                self.lines[name], self._entries[name] = rest, _entry(rest, number)

    def matches(self, name: str | None, secret: str | None) -> bool:
        """Whether the user exists and this is the secret."""
        entry = self._entries.get(name or "")
        if entry is None or secret is None:
            return False
        iterations, salt, wanted = entry
        return hmac.compare_digest(_hash(secret, salt, iterations), wanted)


def _entry(rest: str, number: int) -> tuple[int, bytes, bytes]:
    try:
        empty, scheme, iterations, salt, digest = rest.split("$")
        entry = int(iterations), base64.b64decode(salt, validate=True), base64.b64decode(digest, validate=True)
    except (ValueError, binascii.Error):
        raise PasswordsError(f"line {number} is not NAME:$7$ITERATIONS$SALT$HASH") from None
    if empty or scheme != SCHEME or not 0 < entry[0] <= MAX_ITERATIONS or len(entry[2]) != HASH_BYTES:
        raise PasswordsError(f"line {number} is not a password by PBKDF2 of at most {MAX_ITERATIONS} iterations")
    return entry


def _hash(secret: str, salt: bytes, iterations: int) -> bytes:
    return hashlib.pbkdf2_hmac("sha512", secret.encode(), salt, iterations, HASH_BYTES)


def _text(data: bytes) -> str:
    return base64.b64encode(data).decode()

"""Passwords as scrypt (RFC 7914) with a salt of their own; a text that names its parameters, so that they can grow."""

import hashlib
import hmac
import secrets
from base64 import b64decode, b64encode

COST_LOG2, BLOCK, PARALLEL = 15, 8, 1  # 32 MB and some 80 ms of a core
SALT_BYTES, HASH_BYTES = 16, 32
LEAST_LENGTH, MOST_LENGTH = 12, 200
MEMORY_BYTES = 1 << 27


def hashed(password: str) -> str:
    """Hash a new password."""
    salt = secrets.token_bytes(SALT_BYTES)
    derived = _derive(password, salt, COST_LOG2, BLOCK, PARALLEL)
    numbers = map(str, (COST_LOG2, BLOCK, PARALLEL))
    return "$".join(("scrypt", *numbers, b64encode(salt).decode(), b64encode(derived).decode()))


def agrees(password: str, stored: str) -> bool:
    """Whether a password is the one that was hashed; False for a text that is no such hash."""
    try:
        kind, cost, block, parallel, salt, expected = stored.split("$")
        numbers = int(cost), int(block), int(parallel)
        if kind != "scrypt" or not (1 <= numbers[0] <= 17 and 1 <= numbers[1] <= 8 and 1 <= numbers[2] <= 4):
            return False
        found = _derive(password, b64decode(salt, validate=True), *numbers)
        return hmac.compare_digest(found, b64decode(expected, validate=True))
    except ValueError:
        return False


def weakness(password: str, name: str) -> str | None:
    """Why a new password is not taken; None if it is."""
    if not LEAST_LENGTH <= len(password) <= MOST_LENGTH:
        return f"a password has {LEAST_LENGTH} to {MOST_LENGTH} characters"
    if len(set(password)) < 5 or password.lower() in (name.lower(), name.lower() * 2):
        return "this password is easily guessed; take several words"
    return None


def _derive(password: str, salt: bytes, cost_log2: int, block: int, parallel: int) -> bytes:
    return hashlib.scrypt(
        password.encode(), salt=salt, n=1 << cost_log2, r=block, p=parallel, maxmem=MEMORY_BYTES, dklen=HASH_BYTES
    )

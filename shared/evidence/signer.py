"""The key with which a unit signs: behind `Signer`, whose form today is a file.

A key in a hardware token (PKCS#11) would be a second class with the three members of `Signer`; nothing else asks how
a signature is made. `cryptography` is imported where it is used: it takes 8 MB, which processes that sign nothing do
without.
"""

import base64
import hashlib
import os
import secrets
import stat
from pathlib import Path
from typing import Protocol

from ..errors import ObuError
from ..runtime.private import private_folder
from .ring import KeyRing, PublicKey

KEY_FILE, RING_FILE = "evidence.key", "ring.json"
SECRET_BYTES = PUBLIC_BYTES = 32
# PKCS #8 of an Ed25519 key is this prefix and the 32 bytes of the secret (RFC 8410, section 7).
PKCS8 = bytes.fromhex("302e020100300506032b657004220420")
BEGIN, END = "-----BEGIN PRIVATE KEY-----", "-----END PRIVATE KEY-----"


class EvidenceError(ObuError):
    """A key that cannot be read or made, with what to try next."""


class Signer(Protocol):
    """Signs as this unit."""

    @property
    def key_id(self) -> str:
        """The first 16 hexadecimal digits of the SHA-256 of the public key."""
        ...

    @property
    def public_key(self) -> bytes:
        """The 32 bytes of the Ed25519 public key."""
        ...

    def sign(self, data: bytes, /) -> bytes:
        """Give the 64 bytes of the Ed25519 signature."""
        ...


def keys_folder(state: Path) -> Path:
    """Give the folder of the keys: OBU_KEYS, otherwise `keys` in the state folder, or in that of root beside it."""
    return Path(os.environ.get("OBU_KEYS") or private_folder(state) / "keys")


def key_id_of(public_key: bytes) -> str:
    """Name a public key."""
    return hashlib.sha256(public_key).hexdigest()[:16]


def is_signature(public_key: bytes, signature: bytes, data: bytes) -> bool:
    """Whether a signature is that of a key for these bytes."""
    from cryptography.exceptions import InvalidSignature
    from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PublicKey

    try:
        Ed25519PublicKey.from_public_bytes(public_key).verify(signature, data)
    except (InvalidSignature, ValueError):
        return False
    return True


class FileSigner:
    """A private key in memory, read from a file."""

    def __init__(self, secret: bytes) -> None:
        from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey

        self._key: Ed25519PrivateKey = Ed25519PrivateKey.from_private_bytes(secret)
        self._public = self._key.public_key().public_bytes_raw()
        self._id = key_id_of(self._public)

    @property
    def key_id(self) -> str:
        """Name of the key."""
        return self._id

    @property
    def public_key(self) -> bytes:
        """The public key."""
        return self._public

    def sign(self, data: bytes, /) -> bytes:
        """Sign bytes."""
        return self._key.sign(data)


class KeyFile:
    """The key file of a unit and its ring of public keys; the key is made at first use."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.path = folder / KEY_FILE
        self._read: tuple[tuple[int, int, int], FileSigner] | None = None

    @property
    def ring(self) -> KeyRing:
        """The public keys of this unit, old ones as well; raises `EvidenceError` for a damaged file."""
        try:
            return KeyRing.read(self.folder / RING_FILE)
        except (OSError, ValueError) as error:
            raise EvidenceError(
                f"cannot read {self.folder / RING_FILE}: {error}; restore it from a backup, or name the public keys "
                "with --key"
            ) from error

    def signer(self) -> FileSigner:
        """Give the key that is in the file now, and make one if there is none.

        Raises
        ------
        EvidenceError
            The file or the ring cannot be read or written.
        """
        try:
            if not self.path.exists():
                self._make()
            status = self.path.stat()
            state = status.st_ino, status.st_mtime_ns, status.st_size
            if self._read is None or self._read[0] != state:
                signer = FileSigner(_secret_of(self.path.read_text(encoding="ascii")))
                self._enter(signer)
                self._read = state, signer
        except (OSError, ValueError) as error:
            reason = (error.strerror if isinstance(error, OSError) else None) or str(error)
            raise EvidenceError(
                f"cannot use the key {self.path}: {reason}; check its owner, or make another with `obu evidence-key "
                "rotate`"
            ) from error
        return self._read[1]

    def rotate(self, now_ns: int) -> FileSigner:
        """Replace the private key; the public key of the old one stays in the ring, with the time of its end.

        Parameters
        ----------
        now_ns : int
            [ns] Time of day, UTC.
        """
        secret = secrets.token_bytes(SECRET_BYTES)
        signer = FileSigner(secret)
        try:
            ring = self.ring
            self.folder.mkdir(mode=0o700, parents=True, exist_ok=True)
            for old in ring.keys:
                if old.retired_ns is None:
                    ring = ring.retired(old.key_id, now_ns)
            # The ring first: a key that signs must never be unknown to it.
            ring.with_key(_public(signer, now_ns)).write(self.folder / RING_FILE)
            self._draft(secret).replace(self.path)
        except OSError as error:
            raise EvidenceError(f"cannot write {self.folder}: {error.strerror}; check its owner") from error
        return signer

    def _make(self) -> None:
        """Make the file, unless another process does so at the same moment: a link does not replace."""
        self.folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        draft = self._draft(secrets.token_bytes(SECRET_BYTES))
        try:
            os.link(draft, self.path)
        except FileExistsError:
            return
        finally:
            draft.unlink()

    def _draft(self, secret: bytes) -> Path:
        """Write a secret to a file of its own beside the key, and to the disk."""
        path = self.folder / f".{KEY_FILE}.{os.getpid()}.{secrets.token_hex(4)}"
        text = "\n".join((BEGIN, base64.b64encode(PKCS8 + secret).decode(), END, ""))
        folder = self.folder.stat()
        # Where each process has a user of its own, those that sign share the group of the folder.
        mode = 0o440 if folder.st_mode & stat.S_IXGRP else 0o400
        descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, mode)
        with os.fdopen(descriptor, "w", encoding="ascii") as file:
            if os.geteuid() == 0:
                os.fchown(file.fileno(), folder.st_uid, folder.st_gid)
            os.fchmod(file.fileno(), mode)
            file.write(text)
            file.flush()
            os.fsync(file.fileno())
        return path

    def _enter(self, signer: FileSigner) -> None:
        """Add the key to the ring, if it is not there: its file may have been copied from elsewhere."""
        ring = self.ring
        if ring.find(signer.key_id) is None:
            made_ns = self.path.stat().st_mtime_ns
            ring.with_key(_public(signer, made_ns)).write(self.folder / RING_FILE)


def _public(signer: Signer, made_ns: int) -> PublicKey:
    return PublicKey(key_id=signer.key_id, public_key=signer.public_key, made_ns=made_ns)


def _secret_of(text: str) -> bytes:
    """Read the secret of a PEM file; raises `ValueError`."""
    lines = [line.strip() for line in text.split("\n") if line.strip()]
    if len(lines) < 3 or lines[0] != BEGIN or lines[-1] != END:
        raise ValueError("it is no private key in PEM")
    content = base64.b64decode("".join(lines[1:-1]), validate=True)
    if not content.startswith(PKCS8) or len(content) != len(PKCS8) + SECRET_BYTES:
        raise ValueError("it is no Ed25519 key")
    return content[len(PKCS8) :]

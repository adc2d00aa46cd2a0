"""Tokens and sessions of the page, in one file of the state folder.

Tokens and cookies are random numbers of 32 bytes, of which the file holds only the SHA-256: who reads the file cannot
log in. The command line and the page write the same file, each under a lock, and see each other's changes by its
modification time.
"""

import fcntl
import os
import re
import secrets
import stat
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from hashlib import sha256
from pathlib import Path

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from shared.errors import UserError
from shared.runtime.private import page_folder

from .rights import Right

FILE = "tokens.json"
FOLDER_VARIABLE = "OBU_TOKENS"  # folder of the file, if it is not the state folder: a replay started by a page
TOKEN_BYTES = 32
SECRET_LENGTH = 43  # characters of a token
TOKENS_MAXIMUM = 64
SESSIONS_MAXIMUM = 256
FILE_BYTES_MAXIMUM = 1_000_000
NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_.-]{0,39}")
_SHAPE = re.compile(r"[A-Za-z0-9_-]{43}")


class Token(BaseModel):
    """One token, as the file holds it."""

    model_config = ConfigDict(frozen=True, extra="forbid")
    name: str
    role: Right
    hash: str
    created_s: float
    expires_s: float | None = None
    single_use: bool = False  # of a link that logs in: it ends with the first login


class Session(BaseModel):
    """One login; it ends with its token, with the logout, or after its time."""

    model_config = ConfigDict(frozen=True, extra="forbid")
    token: str
    role: Right
    hash: str
    created_s: float
    expires_s: float


class Content(BaseModel):
    """The file: `unit` distinguishes the cookies of two units on one host, which browsers do not keep apart by port."""

    model_config = ConfigDict(extra="forbid")
    unit: str = Field(default_factory=lambda: secrets.token_hex(4))
    tokens: tuple[Token, ...] = ()
    sessions: tuple[Session, ...] = ()


class Tokens:
    """Reads and changes the file; the time of day decides what has expired."""

    def __init__(self, folder: Path, now_s: Callable[[], float] = time.time) -> None:
        self.path = folder / FILE
        self._now_s = now_s
        self._seen: tuple[int, int, int] | None = None
        self._content = Content()
        self.problem: str | None = None  # why the file cannot be read; nobody can log in then

    def make(self) -> None:
        """Make the file if there is none; raises `UserError` if it cannot be written."""
        if not self.path.exists():
            with self._changing() as content:
                self._write(content)

    def content(self) -> Content:
        """What the file holds now; an unreadable file holds nobody who may log in."""
        try:
            status = self.path.stat()
            seen = (status.st_mtime_ns, status.st_ino, status.st_size)
            if seen != self._seen:
                self._content, self._seen, self.problem = _read(self.path), seen, None
        except (OSError, ValueError) as error:
            self._content, self._seen, self.problem = Content(unit=self._content.unit), None, _reason(error)
        return self._content

    def add(self, name: str, role: Right, *, seconds: float | None = None, single_use: bool = False) -> str:
        """Add a token and return it: it is shown once, and cannot be read from the file.

        Raises
        ------
        UserError
            If the name is taken or no name, or there are too many tokens.
        """
        if not NAME.fullmatch(name):
            raise UserError(f"{name[:60]!r} is no name of a token: take letters, digits, - and _, such as workshop-2")
        secret = secrets.token_urlsafe(TOKEN_BYTES)
        with self._changing() as content:
            if any(token.name == name for token in content.tokens):
                raise UserError(f"there is a token {name} already; take another name, or `obu token revoke {name}`")
            if len(content.tokens) >= TOKENS_MAXIMUM:
                raise UserError(f"there are {len(content.tokens)} tokens; revoke one, `obu token list` shows them")
            now_s = self._now_s()
            expires_s = None if seconds is None else now_s + seconds
            token = Token(name=name, role=role, hash=hashed(secret), created_s=now_s, expires_s=expires_s,
                          single_use=single_use)  # fmt: skip
            content.tokens += (token,)
            self._write(content)
        return secret

    def add_temporary(self, kind: str, role: Right, *, seconds: float, single_use: bool = False) -> str:
        """Add a token with a name of its own, which expires."""
        return self.add(f"{kind}-{secrets.token_hex(3)}", role, seconds=seconds, single_use=single_use)

    def revoke(self, name: str) -> int:
        """Remove a token and end its sessions; returns their number. Raises `UserError` if there is neither."""
        with self._changing() as content:
            tokens = tuple(token for token in content.tokens if token.name != name)
            sessions = tuple(session for session in content.sessions if session.token != name)
            ended = len(content.sessions) - len(sessions)
            if len(tokens) == len(content.tokens) and not ended:
                raise UserError(f"there is no token {name[:60]!r}; `obu token list` shows them")
            content.tokens, content.sessions = tokens, sessions
            self._write(content)
        return ended

    def find(self, secret: str) -> Token | None:
        """The valid token of that text, if there is one."""
        key, now_s = hashed(secret), self._now_s()
        return next((t for t in self.content().tokens if t.hash == key and not _expired(t.expires_s, now_s)), None)

    def session(self, cookie: str) -> Session | None:
        """The valid session of a cookie, if there is one."""
        key = hashed(cookie)
        return next((session for session in self.valid_sessions() if session.hash == key), None)

    def valid_sessions(self) -> list[Session]:
        """Sessions that have not ended."""
        now_s = self._now_s()
        return [session for session in self.content().sessions if not _expired(session.expires_s, now_s)]

    def log_in(self, secret: str, seconds: float) -> tuple[str, Session] | None:
        """Open a session: the value of its cookie, and the session; None for an unknown token.

        A token of single use is removed in the same step, so that of two logins one succeeds.
        """
        if self.find(secret) is None:  # without a write for a wrong one
            return None
        with self._changing() as content:
            now_s, key = self._now_s(), hashed(secret)
            token = next((t for t in content.tokens if t.hash == key and not _expired(t.expires_s, now_s)), None)
            if token is None:
                return None
            cookie = secrets.token_urlsafe(TOKEN_BYTES)
            session = Session(
                token=token.name, role=token.role, hash=hashed(cookie), created_s=now_s, expires_s=now_s + seconds
            )
            if token.single_use:
                content.tokens = tuple(item for item in content.tokens if item is not token)
            content.sessions = (*content.sessions[-SESSIONS_MAXIMUM + 1 :], session)
            self._write(content)
        return cookie, session

    def log_out(self, session: Session) -> None:
        """End a session; one that has ended already stays ended."""
        with self._changing() as content:
            content.sessions = tuple(item for item in content.sessions if item.hash != session.hash)
            self._write(content)

    @contextmanager
    def _changing(self) -> Iterator[Content]:
        """Lock the file, and give its content without what has expired."""
        try:
            flags = os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW | os.O_CLOEXEC  # no link to a file that is not ours
            with os.fdopen(os.open(self.path.with_suffix(".lock"), flags, 0o600), "r+") as lock:
                _own_as_folder(lock.fileno(), self.path.parent)
                fcntl.flock(lock, fcntl.LOCK_EX)
                content = _read(self.path) if self.path.exists() else Content()
                now_s = self._now_s()
                content.tokens = tuple(token for token in content.tokens if not _expired(token.expires_s, now_s))
                content.sessions = tuple(
                    session for session in content.sessions if not _expired(session.expires_s, now_s)
                )
                yield content
        except OSError as error:
            raise UserError(
                f"cannot write {self.path}: {error.strerror or error}; run this as the user who runs the unit"
            ) from error
        except ValueError as error:
            raise UserError(
                f"{self.path}: {_reason(error)}; move it away, and make new tokens with `obu token add`"
            ) from error

    def _write(self, content: Content) -> None:
        draft = self.path.with_suffix(".draft")
        draft.unlink(missing_ok=True)
        with os.fdopen(os.open(draft, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600), "w", encoding="utf-8") as file:
            _own_as_folder(file.fileno(), self.path.parent)
            file.write(content.model_dump_json(indent=1) + "\n")
            file.flush()
            os.fsync(file.fileno())
        draft.replace(self.path)


def hashed(secret: str) -> str:
    """SHA-256 of a token; a number of 256 random bits needs no slower one."""
    return sha256(secret.encode()).hexdigest()


def is_secret(text: str) -> bool:
    """Whether a text has the form of a token."""
    return bool(_SHAPE.fullmatch(text))


def tokens_folder(state: Path) -> Path:
    """The folder of the tokens of a unit with this state folder."""
    named = os.environ.get(FOLDER_VARIABLE)
    return Path(named) if named else page_folder(state)


def _expired(expires_s: float | None, now_s: float) -> bool:
    return expires_s is not None and now_s >= expires_s


def _read(path: Path) -> Content:
    with path.open("rb") as file:
        return Content.model_validate_json(file.read(FILE_BYTES_MAXIMUM))


def _reason(error: Exception) -> str:
    if isinstance(error, ValidationError):
        return "not a file of tokens of this version"
    return str(error.strerror or error) if isinstance(error, OSError) else str(error)


def _own_as_folder(descriptor: int, folder: Path) -> None:
    """Give a file that root makes to the owner of the folder, so that the unit can read it."""
    found = os.fstat(descriptor)
    if os.geteuid() == 0 and stat.S_ISREG(found.st_mode) and found.st_nlink == 1:
        owner = folder.stat()
        os.fchown(descriptor, owner.st_uid, owner.st_gid)
        os.fchmod(descriptor, 0o600)

"""`obu evidence-key`: the key with which this unit signs recordings and charges, and those that it accepts."""

import os
import time
from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated

import typer

from shared.errors import UserError
from shared.evidence import EvidenceError, KeyFile, KeyRing, PublicKey, keys_folder
from shared.runtime.config import state_dir

KeyOption = Annotated[
    list[Path] | None,
    typer.Option(
        "--key", metavar="FILE",
        help="Accept the public keys of this file (PEM, or a ring.json) instead of those of this unit; repeatable.",
    ),
]  # fmt: skip


def accepted_keys(files: Sequence[Path] | None) -> KeyRing:
    """Collect the keys of files, otherwise those of this unit; raises `UserError`."""
    try:
        return (
            KeyRing.of_files(files) if files else KeyFile(keys_folder(Path(os.environ.get("OBU_STATE", ".obu")))).ring
        )  # makes no folder
    except OSError as error:
        raise UserError(f"cannot read {error.filename}: {error.strerror}; name a file of public keys") from error
    except ValueError as error:
        raise UserError(f"{error}; export one with `obu evidence-key export`") from error
    except EvidenceError as error:
        raise UserError(str(error)) from error


def show() -> int:
    """Print the keys of this unit: the one that signs, and former ones whose signatures stay valid.

    The key is made if there is none.

    Example: [bold]obu evidence-key show[/]
    """
    key = _key_file()
    current, ring = _current(key), accepted_keys(None)
    print(f"private key: {key.path}")
    for public_key in ring.keys:
        since = f"since {_date(public_key.made_ns)}" if public_key.made_ns else ""
        state = (
            f"until {_date(public_key.retired_ns)}"
            if public_key.retired_ns
            else "signs now"
            if public_key.key_id == current
            else ""
        )
        print(f"{public_key.key_id}  {since}  {state}".rstrip())
    return 0


def rotate() -> int:
    """Make another key; files that the old one has signed stay verified, because its public key is kept.

    A recording in progress is finished with the old key.

    Example: [bold]obu evidence-key rotate[/]
    """
    try:
        signer = _key_file().rotate(time.time_ns())
    except EvidenceError as error:
        raise UserError(str(error)) from error
    print(f"new key {signer.key_id}; give it to those who verify: `obu evidence-key export`")
    return 0


def export(
    output: Annotated[
        Path | None, typer.Option("-o", "--output", metavar="FILE", help="Write this file; without it to the terminal.")
    ] = None,
) -> int:
    """Print the public keys of this unit in PEM, for those who verify its files elsewhere.

    Examples:
    [bold]obu evidence-key export -o car.pub[/]
    [bold]obu verify drive.mcap --key car.pub[/]
    """
    _current(_key_file())
    text = "".join(_described(key) for key in accepted_keys(None).keys)
    if output is None:
        print(text, end="")
        return 0
    try:
        output.write_text(text, encoding="ascii")
    except OSError as error:
        raise UserError(f"cannot write {output}: {error.strerror}; choose another file with --output") from error
    print(f"wrote {output}")
    return 0


def _key_file() -> KeyFile:
    return KeyFile(keys_folder(state_dir()))


def _current(key: KeyFile) -> str:
    try:
        return key.signer().key_id
    except EvidenceError as error:
        raise UserError(str(error)) from error


def _described(key: PublicKey) -> str:
    return f"# key {key.key_id}\n{key.pem()}"


def _date(stamp_ns: int) -> str:
    return f"{datetime.fromtimestamp(stamp_ns // 1_000_000_000, UTC):%Y-%m-%d %H:%M} UTC"

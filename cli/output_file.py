"""The place of a file that a command writes at its end, checked before its work."""

import os
from pathlib import Path

from shared.errors import UserError


def insist_on_place(path: Path, option: str = "--out") -> None:
    """Raise `UserError` where a file cannot be written, before long work is done for it."""
    folder = path.parent
    if not folder.is_dir():
        reason = f"there is no folder {folder}"
    elif path.is_dir():
        reason = "it is a folder"
    elif not os.access(path if path.exists() else folder, os.W_OK):
        reason = "this user may not write it"
    else:
        return
    raise UserError(f"cannot write {path}: {reason}; choose another path with {option}")


def insist_on_new(path: Path, option: str = "--out") -> None:
    """Raise `UserError` where a file cannot be written, or is there already."""
    insist_on_place(path, option)
    if path.exists():
        raise UserError(f"{path} already exists; choose another file with {option}, or remove it")


def write_text(path: Path, text: str, option: str = "--out") -> None:
    """Write a file; raises `UserError`."""
    try:
        path.write_text(text, encoding="utf-8")
    except OSError as error:
        raise UserError(f"cannot write {path}: {error.strerror}; choose another path with {option}") from error

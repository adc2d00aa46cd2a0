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

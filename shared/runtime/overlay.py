"""The settings that hold: the vehicle's file, or the text that `controller.settings` has written over it.

The text begins with a line that names the digest of the file it was made from. A file that was edited by hand since
then has another digest: the file holds, and the text is set aside.
"""

import hashlib
import logging
import re
from pathlib import Path

from ..bounded import TOML_BYTES, SizeExceeded, read_text
from .private import private_folder

log = logging.getLogger(__name__)

SETTINGS, FILE = "settings", "vehicle.toml"  # in the folder of root, or in the state folder
_BASIS = re.compile(r"# Changed settings of a unit, over the vehicle's file of sha256 ([0-9a-f]{64})\.[^\n]*\n")


def settings_folder(state: Path) -> Path:
    """Folder of the changed settings and of their earlier texts, which controller.settings alone writes."""
    return private_folder(state) / SETTINGS


def digest_of(text: str) -> str:
    """SHA-256 of a text, in hexadecimal digits."""
    return hashlib.sha256(text.encode()).hexdigest()


def over(text: str, shipped: str) -> str:
    """Text to be written over a file: with the line that names the file's digest."""
    return (
        f"# Changed settings of a unit, over the vehicle's file of sha256 {digest_of(shipped)}.\n{without_basis(text)}"
    )


def without_basis(text: str) -> str:
    """Text without the line that names a digest."""
    return _BASIS.sub("", text, count=1)


def basis_of(text: str) -> str | None:
    """Digest of the file that a text was made from; None of a text that names no digest."""
    found = _BASIS.match(text)
    return found[1] if found else None


def text_over(shipped: str, state: Path) -> tuple[Path, str] | None:
    """Text that holds in the place of a vehicle's file, and where it is; None where the file itself holds."""
    path = settings_folder(state) / FILE
    try:
        text = read_text(path, TOML_BYTES)
    except FileNotFoundError:
        return None
    except (OSError, UnicodeDecodeError, SizeExceeded) as error:
        log.warning("the changed settings in %s cannot be read, and the vehicle's file holds: %s", path, error)
        return None
    return (path, text) if basis_of(text) == digest_of(shipped) else None

"""Where secrets, the key that signs, and the tokens of the page are.

Where each process has a user of its own, the state folder can be written by all of them: whoever may write a folder may
rename what is in it. What not every process may touch is then in a folder of root beside it, which `deploy/` makes.
"""

from pathlib import Path

PAGE, UPLINK = "page", "uplink"  # in the folder of root: of monitoring.status and of monitoring.uplink
STATE, PRIVATE = Path("/var/lib/obu"), Path("/var/lib/obu-private")


def private_folder(state: Path) -> Path:
    """Folder for what not every process of a unit may touch; where one user runs them all, the state folder itself."""
    try:
        return PRIVATE if state == STATE and PRIVATE.is_dir() else state
    except OSError:
        return state


def page_folder(state: Path) -> Path:
    """Folder of the tokens and of the address of the page, which monitoring.status alone writes."""
    private = private_folder(state)
    return private / PAGE if private != state else state

"""Copies of the tree, in which tests may be run after a change."""

import shutil
import subprocess
from pathlib import Path

NODE_MODULES = Path("services/monitoring/status/dashboard/node_modules")


def copied_tree(root: Path, to: Path) -> list[str]:
    """Copy what git knows of a tree and what is new in it, beside the libraries of the dashboard; gives the files.

    Raises
    ------
    CalledProcessError
        `root` is no work tree of git.
    """
    command = ["git", "ls-files", "-z", "--cached", "--others", "--exclude-standard"]
    listed = subprocess.run(command, cwd=root, capture_output=True, text=True, check=True).stdout
    names = [name for name in listed.split("\0") if name and (root / name).is_file()]
    for name in names:
        (to / name).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy2(root / name, to / name)
    if (root / NODE_MODULES).is_dir():
        (to / NODE_MODULES).symlink_to(root / NODE_MODULES)
    return names

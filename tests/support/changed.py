"""Name the folders of unit tests beside what has changed; `make quick` runs them.

Changed is what is not committed, and what the commits since a base have touched. The tests of a file are in the nearest
folder of `tests/unit` with the same path, without the file's own name.
"""

import subprocess
import sys
from collections.abc import Iterable
from pathlib import Path, PurePosixPath

ROOT = Path(__file__).resolve().parents[2]
UNIT = PurePosixPath("tests/unit")


def changed(base: str) -> list[PurePosixPath]:
    """Files that differ from a commit, committed or not, and new ones."""
    commands = (["git", "diff", "--name-only", base], ["git", "ls-files", "--others", "--exclude-standard"])
    found = [
        subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True).stdout for command in commands
    ]
    return [PurePosixPath(line) for text in found for line in text.splitlines()]


def tests_of(path: PurePosixPath) -> PurePosixPath | None:
    """Test file or nearest folder of tests of a file, None of one that has none."""
    if path.is_relative_to("tests"):
        return path if path.is_relative_to(UNIT) and path.name.startswith("test_") and (ROOT / path).exists() else None
    if path.suffix not in (".py", ".toml") or len(path.parts) < 2:
        return None
    inner = PurePosixPath(*path.parts[1:]) if path.parts[0] == "services" else path
    for folder in inner.parents:
        if folder.parts and (ROOT / UNIT / folder).is_dir():
            return UNIT / folder
    return None


def folders(paths: Iterable[PurePosixPath]) -> list[PurePosixPath]:
    """Folders of tests, without those that lie in another one of them."""
    found = {tests for path in paths if (tests := tests_of(path)) is not None}
    return sorted(path for path in found if not any(parent in found for parent in path.parents))


if __name__ == "__main__":
    sys.stdout.write(" ".join(map(str, folders(changed(sys.argv[1] if len(sys.argv) > 1 else "HEAD")))))

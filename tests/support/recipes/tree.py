"""A copy of the repository, in which a recipe of `docs/how-to/add` is followed."""

import os
import shutil
import subprocess
import sys
from collections.abc import Iterable
from pathlib import Path
from typing import NamedTuple

from tests.support.copied import copied_tree
from tests.support.patience import HANGS_S

ROOT = Path(__file__).resolve().parents[3]


class Edit(NamedTuple):
    """A change of a file: text behind another one, in place of it, or as a new file."""

    path: str
    text: str
    after: str = ""
    instead_of: str = ""

    def made(self, before: str) -> str:
        """Text of the file behind the change."""
        anchor = self.after or self.instead_of
        if not anchor:
            return self.text
        if before.count(anchor) != 1:
            raise ValueError(f"{self.path} has {anchor!r} {before.count(anchor)} times")
        return before.replace(anchor, self.after + self.text)


class Tree:
    """The copy: it is changed, judged, and restored."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._files = {name: (folder / name).read_bytes() for name in copied_tree(ROOT, folder)}
        self._made: set[str] = set()

    def edit(self, edits: Iterable[Edit]) -> None:
        """Change files."""
        for edit in edits:
            path = self.folder / edit.path
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(edit.made(path.read_text(encoding="utf-8") if path.exists() else ""), encoding="utf-8")
            self._made.add(edit.path)

    def printed(self, command: Iterable[str]) -> set[str]:
        """Run what prints files; gives those that have changed by it."""
        before = self._made | self._changed()
        result = self.run(*command)
        if result.returncode != 0:
            raise RuntimeError(result.stderr)
        return self._changed() - before

    def restore(self) -> None:
        """Return to the state of the repository."""
        for name in self._changed():
            (self.folder / name).write_bytes(self._files[name])
        for name in self._made - self._files.keys():
            path = self.folder / name
            path.unlink(missing_ok=True)
            if not any(kept.startswith(f"{Path(name).parent}/") for kept in self._files):
                shutil.rmtree(path.parent, ignore_errors=True)  # a new folder, with what Python has compiled there
        self._made.clear()

    def run(self, *arguments: str) -> subprocess.CompletedProcess[str]:
        """Run Python in the copy."""
        environment = {name: value for name, value in os.environ.items() if not name.startswith(("PYTEST", "OBU"))}
        return subprocess.run(
            [sys.executable, *arguments],
            cwd=self.folder, env=environment, capture_output=True, text=True, timeout=HANGS_S, check=False,
        )  # fmt: skip

    def test(self, tests: Iterable[str]) -> subprocess.CompletedProcess[str]:
        """Run tests in the copy."""
        return self.run("-m", "pytest", "-q", "-x", "-p", "no:cacheprovider", "-p", "no:xdist", *sorted(set(tests)))

    def _changed(self) -> set[str]:
        return {name for name, content in self._files.items() if (self.folder / name).read_bytes() != content}

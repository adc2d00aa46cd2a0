"""`obu migrate`: a vehicle's file of an earlier version, rewritten with the keys of this one."""

import os
from pathlib import Path
from typing import Annotated

import typer

from shared.bounded import TOML_BYTES, SizeExceeded, read_text
from shared.errors import UserError
from shared.runtime.config import NO_TEXT, parse_vehicle, state_dir
from shared.runtime.live import load_process
from shared.runtime.migration import migrated
from shared.runtime.overlay import over, text_over, without_basis

from .unit_files import replace


def migrate(
    file: Annotated[Path, typer.Argument(help="A vehicle's TOML file.")],
    *,
    output: Annotated[
        Path | None,
        typer.Option(
            "-o", "--output", metavar="FILE",
            help="Write this file instead; without it FILE is replaced, and its former text kept as FILE.old.",
        ),
    ] = None,
    check: Annotated[bool, typer.Option("--check", help="Write nothing; end with 1 if anything is old.")] = False,
) -> int:  # fmt: skip
    """Rewrite a vehicle's file of an earlier version; comments and order stay.

    Files inside recordings need no migration: they are translated when they are read. With the file of OBU_VEHICLE, the
    settings that the page has changed over it are rewritten too.

    Examples:
    [bold]obu migrate car.toml[/]
    [bold]obu migrate car.toml --check[/]
    [bold]obu migrate car.toml -o new.toml[/]
    """
    try:
        text = read_text(file, TOML_BYTES)
    except (OSError, ValueError) as error:
        reason = error.strerror if isinstance(error, OSError) else error if isinstance(error, SizeExceeded) else NO_TEXT
        raise UserError(f"cannot read {file}: {reason}; give a vehicle's TOML file") from error
    new, changes = _rewritten(text, str(file))
    held = None if output else _changed_over(file, text, new)
    if held:
        path, changed = held
        rewritten, changes_over = _rewritten(without_basis(changed), str(path))
        changes = [*changes, *(f"{path}: {change}" for change in changes_over)]
    for change in changes:
        print(change)
    if check:
        print(f"{file}: {len(changes)} old settings" if changes else f"{file} has the keys of this version")
        return 1 if changes else 0
    if not changes and output is None:
        print(f"{file} has the keys of this version; nothing is written")
        return 0
    if held:
        _write_over(path, over(rewritten, new))  # first: after a break in between, the next run finishes it
    if output or new != text:
        _write(file, output, text, new)
    return 0


def _rewritten(text: str, name: str) -> tuple[str, list[str]]:
    """Text with the keys of this version, and what changes; raises `UserError` for what is wrong beside old keys."""
    new, changes = migrated(text, name)
    vehicle = parse_vehicle(new, name)
    for process in vehicle.processes:
        if process in vehicle.tables:
            load_process(process, vehicle)
    return new, list(changes)


def _changed_over(file: Path, *texts: str) -> tuple[Path, str] | None:
    """Where the settings that hold over the file of this unit are, and their text; the file has one of `texts`."""
    named = os.environ.get("OBU_VEHICLE")
    if not named or Path(named).resolve() != file.resolve():
        return None
    return next((found for text in texts if (found := text_over(text, state_dir()))), None)


def _write_over(path: Path, text: str) -> None:
    try:
        replace(path, text.encode(), 0o640, keep_old=False)
    except OSError as error:
        raise UserError(f"cannot write {path}: {error.strerror}; run the command with `sudo`") from error
    print(f"wrote {path}: the changes of the page hold over the new file")


def _write(file: Path, output: Path | None, text: str, new: str) -> None:
    old = file.with_name(f"{file.name}.old")
    target = output or file
    try:
        if output is None:
            old.write_text(text, encoding="utf-8")
        draft = target.with_name(f".{target.name}.new")
        draft.write_text(new, encoding="utf-8")
        if target.exists():
            draft.chmod(target.stat().st_mode & 0o777)
        draft.replace(target)
    except OSError as error:
        raise UserError(f"cannot write {target}: {error.strerror}; choose another path with --output") from error
    print(f"wrote {target}" + ("" if output else f"; the former text is in {old}"))

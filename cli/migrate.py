"""`obu migrate`: a vehicle's file of an earlier version, rewritten with the keys of this one."""

from pathlib import Path
from typing import Annotated

import typer

from shared.bounded import TOML_BYTES, SizeExceeded, read_text
from shared.errors import UserError
from shared.runtime.config import NO_TEXT, parse_vehicle
from shared.runtime.live import load_process
from shared.runtime.migration import migrated


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

    Files inside recordings need no migration: they are translated when they are read.

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
    new, changes = migrated(text, str(file))
    vehicle = parse_vehicle(new, str(file))
    for name in vehicle.processes:
        if name in vehicle.tables:
            load_process(name, vehicle)  # raises what is wrong beside the old keys, before anything is written
    for change in changes:
        print(change)
    if check:
        print(f"{file}: {len(changes)} old settings" if changes else f"{file} has the keys of this version")
        return 1 if changes else 0
    if not changes and output is None:
        print(f"{file} has the keys of this version; nothing is written")
        return 0
    _write(file, output, text, new)
    return 0


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

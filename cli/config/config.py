"""`obu config`: list, read and change the settings of a vehicle's file, and take changes back."""

import json as json_module
import os
from pathlib import Path
from typing import Annotated

import typer
from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from shared.bounded import TOML_BYTES, read_text
from shared.errors import ConfigError, UserError
from shared.recording.writer import without_users
from shared.runtime.config import VehicleFile, parse_vehicle, state_dir
from shared.runtime.overlay import over, settings_folder, text_over, without_basis
from shared.settings.catalogue import Setting, catalogue, find, value_of
from shared.settings.edit import REMOVED, Difference, checked, differences, edited, touched, value_from
from shared.settings.history import History, Version, write

FileOption = Annotated[
    Path | None, typer.Option("--vehicle", metavar="FILE", help="The vehicle's TOML file; without it OBU_VEHICLE.")
]
JsonOption = Annotated[bool, typer.Option("--json", help="Print JSON.")]
DryOption = Annotated[bool, typer.Option("--dry-run", help="Print what would change, and write nothing.")]
NameArgument = Annotated[str, typer.Argument(help="Name of a setting, such as core.fusion.gnss.delay_s.")]


def list_settings(
    search: Annotated[
        str | None, typer.Argument(help="Only those with this in their name or their meaning, or of this section.")
    ] = None,
    *,
    changed: Annotated[bool, typer.Option("--changed", help="Only those that differ from their defaults.")] = False,
    vehicle: FileOption = None,
    json: JsonOption = False,
) -> int:
    """List settings with their values; without a vehicle's file their defaults.

    Examples:
    [bold]obu config list delay[/]
    [bold]obu config list core.fusion --changed[/]
    """
    file = _read(vehicle) if vehicle is not None or "OBU_VEHICLE" in os.environ else parse_vehicle("")
    wanted = (search or "").lower()
    rows = [
        (setting, value)
        for setting in catalogue(file.role, file.processes)
        if wanted in f"{setting.name} {setting.meaning}".lower()
        and ((value := value_of(file, setting)) != setting.default or not changed)
    ]
    if json:
        print(json_module.dumps([_described(setting, value) for setting, value in rows], indent=1))
        return 0
    if not rows:
        print("no setting " + (f"has {search!r} in its name or meaning" if search else "differs from its default"))
        return 1
    table = Table(box=SIMPLE_HEAD, pad_edge=False, show_edge=False)
    for heading in ("setting", "value", "default"):
        table.add_column(heading, overflow="fold")
    for setting, value in rows:
        shown = _shown(value)
        table.add_row(escape(setting.name), escape(shown), "" if value == setting.default else _shown(setting.default))
    Console().print(table)
    return 0


def get(name: NameArgument, *, vehicle: FileOption = None, json: JsonOption = False) -> int:
    """Print the value of a setting, and what it means.

    Example: [bold]obu config get core.fusion.gnss.delay_s[/]
    """
    setting = find(name)
    value = value_of(_read(vehicle), setting)
    if json:
        print(json_module.dumps(_described(setting, value), indent=1))
        return 0
    print(f"{setting.name} = {_shown(value)}")
    print(setting.meaning)
    for text in (", ".join((setting.kind, *setting.bounds)), ", ".join(setting.choices)):
        if text:
            print(f"  {text}")
    print(f"  default {_shown(setting.default)}")
    return 0


def set_values(
    changes: Annotated[list[str], typer.Argument(metavar="NAME=VALUE...", help="Settings and their new values.")],
    *,
    vehicle: FileOption = None,
    dry_run: DryOption = False,
) -> int:
    """Change settings; the whole file is checked first, its comments stay, and its former text is kept.

    Values are written as in TOML. Processes take them up when they start again.

    Examples:
    [bold]obu config set core.fusion.gnss.delay_s=0.08[/]
    [bold]obu config set vehicle.gnss.lever_arm_body_m="[0.3, 0.0, -1.2]" --dry-run[/]
    """
    values: dict[str, object] = {}
    for change in changes:
        name, equals, text = change.partition("=")
        if not equals:
            raise UserError(f"{change!r} has no value; write it as {change}=VALUE")
        setting = find(name.strip())
        values[setting.name] = value_from(text.strip(), setting)
    return _change(_path(vehicle), values, dry_run=dry_run)


def unset(
    names: Annotated[list[str], typer.Argument(metavar="NAME...", help="Settings whose defaults shall hold.")],
    *,
    vehicle: FileOption = None,
    dry_run: DryOption = False,
) -> int:
    """Take settings out of the file, so that their defaults hold.

    Example: [bold]obu config unset core.fusion.gnss.delay_s[/]
    """
    return _change(_path(vehicle), {find(name).name: REMOVED for name in names}, dry_run=dry_run)


def diff(
    version: Annotated[int, typer.Argument(help="Number in `obu config history`.")] = 1,
    *,
    vehicle: FileOption = None,
) -> int:
    """Print what differs between an earlier text of the file and the present one; ends with 1 if anything does.

    Example: [bold]obu config diff 2[/]
    """
    file, earlier = _read(vehicle), _version(version)
    changes = differences(parse_vehicle(earlier.text(), str(earlier.path)), file)
    _print(changes)
    if not changes:
        print("no setting differs")
    return 1 if changes else 0


def history(*, vehicle: FileOption = None) -> int:
    """List the earlier texts of the file, and how many settings differ from the present one.

    Example: [bold]obu config history[/]
    """
    file, versions = _read(vehicle), _history().versions()
    if not versions:
        print("nothing was changed by `obu config` yet")
    for number, version in enumerate(versions, 1):
        count = len(differences(parse_vehicle(version.text(), str(version.path)), file))
        print(f"{number:3}  replaced {version.replaced:%Y-%m-%d %H:%M:%S} UTC  {count} settings differ")
    return 0


def undo(
    version: Annotated[int, typer.Argument(help="Number in `obu config history`.")] = 1,
    *,
    vehicle: FileOption = None,
    dry_run: DryOption = False,
) -> int:
    """Restore an earlier text of the file, the newest if none is named; the present one is kept, so that it can return.

    Example: [bold]obu config undo[/]
    """
    path = _path(vehicle)
    return _replace(path, _version(version).text(), dry_run=dry_run)


def _change(path: Path, values: dict[str, object], *, dry_run: bool) -> int:
    return _replace(path, edited(_text(path), values), dry_run=dry_run)


def _replace(path: Path, text: str, *, dry_run: bool) -> int:
    """Check another text of a file, print what differs, and write it.

    Where the page has changed the settings of this unit, its text holds in the place of the file, and is written.
    """
    former = _text(path)
    after = checked(text, str(path))
    try:
        before = parse_vehicle(former, str(path))
        changes = differences(before, after)
        names = touched(changes, after, before)
    except ConfigError as error:  # what is replaced is invalid: that is what is mended
        print(f"the present text cannot be compared: {error}")
        changes, names = [], list(after.processes)
    if text == former:
        print("the file says that already; nothing is written")
        return 0
    _print(changes)
    if dry_run:
        print(f"nothing is written to {path}")
        return 0
    try:
        _history().keep(former)
        changed = _changed(path)
        written = path if changed is None else changed[0]
        write(written, text if changed is None else over(text, _shipped_text(path)), written.stat().st_mode & 0o777)
    except OSError as error:
        raise UserError(f"cannot write {path}: {error.strerror}; is it yours, and is there room?") from error
    print(f"wrote {written}; `obu config undo` takes it back")
    if names:
        print(f"start again, for it to hold: {', '.join(names)}")
    return 0


def _print(changes: list[Difference]) -> None:
    for change in changes:
        print(f"{change.setting.name}: {_shown(change.before)} -> {_shown(change.after)}")


def _shown(value: object) -> str:
    """Value as text, without users and passwords of addresses."""
    return "not set" if value is None else without_users(json_module.dumps(value, ensure_ascii=False))


def _described(setting: Setting, value: object) -> dict[str, object]:
    shown = None if value is None else json_module.loads(_shown(value))
    return {
        "name": setting.name, "value": shown, "default": setting.default, "kind": setting.kind,
        "bounds": list(setting.bounds), "choices": list(setting.choices), "meaning": setting.meaning,
    }  # fmt: skip


def _path(vehicle: Path | None) -> Path:
    name = vehicle or os.environ.get("OBU_VEHICLE")
    if not name:
        raise UserError("no vehicle's file is named: add --vehicle FILE, or set OBU_VEHICLE")
    return Path(name)


def _changed(path: Path) -> tuple[Path, str] | None:
    """Text that the page of this unit has written over a file, and where; None where the file itself holds."""
    return text_over(_shipped_text(path), state_dir()) if str(path) == os.environ.get("OBU_VEHICLE") else None


def _text(path: Path) -> str:
    changed = _changed(path)
    return _shipped_text(path) if changed is None else without_basis(changed[1])


def _shipped_text(path: Path) -> str:
    try:
        return read_text(path, TOML_BYTES)
    except (OSError, ValueError) as error:
        reason = error.strerror if isinstance(error, OSError) else error
        raise UserError(f"cannot read the vehicle's file {path}: {reason}; name another with --vehicle") from error


def _read(vehicle: Path | None) -> VehicleFile:
    path = _path(vehicle)
    return parse_vehicle(_text(path), str(path))


def _history() -> History:
    return History(settings_folder(state_dir()))


def _version(number: int) -> Version:
    versions = _history().versions()
    if not 1 <= number <= len(versions):
        raise UserError(f"there is no earlier text {number}; `obu config history` lists {len(versions)}")
    return versions[number - 1]

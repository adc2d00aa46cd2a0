"""`obu backup`, `obu restore`, `obu reset`: a unit into new hardware, and back to how it was delivered.

A backup is a zip file: `about.json` with version, time and the SHA-256 of each file, `vehicle.toml` with the settings
that hold, and one folder a place of the unit (`PLACES`). It is read as hostile bytes: only names of these places, each
within its bound, each with its digest.
"""

import hashlib
import os
import re
import urllib.error
import urllib.request
import zipfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated

import typer
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from services.monitoring.status.web.access.tokens import tokens_folder
from shared import VERSION, shipped
from shared.bounded import TOML_BYTES, SizeExceeded
from shared.errors import UserError
from shared.evidence import keys_folder
from shared.fleet.identity import identity_folder
from shared.runtime.config import VehicleFile, load_vehicle, page_of, parse_vehicle, state_dir
from shared.runtime.overlay import settings_folder
from shared.runtime.private import STATE

from .unit_files import delete, is_plain, read_plain, replace

VehicleOption = Annotated[
    Path | None, typer.Option("--vehicle", metavar="FILE", help="The vehicle's TOML file; without it OBU_VEHICLE.")
]
ABOUT, SETTINGS = "about.json", "vehicle.toml"
FILE_BYTES, ABOUT_BYTES, FILES = 4 << 20, 1 << 20, 200
MODES = 0o660  # the rights that a restored file may have
ANSWER_S = 2.0
BACKUPS = Path("/var/backups/obu")  # of deploy/install.sh, before an upgrade
LEFT = r"(?:\.old|\.part|\.old\.part)?"  # what a replaced file leaves beside it


@dataclass(frozen=True)
class Place:
    """Files of a unit that a backup holds, and whether whoever has them can speak in its name."""

    folder: Callable[[Path], Path]  # of the state folder
    names: str  # regular expression
    secret: bool
    meaning: str


PLACES = {
    "state": Place(lambda state: state, r"saved-[a-z0-9_-]{1,80}\.json", False, "what the unit has learned"),
    "keys": Place(keys_folder, r"(?:evidence\.key|ring\.json)", True, "the key that signs recordings and charges"),
    "uplink": Place(identity_folder, r"[a-z0-9_-]{1,40}\.(?:json|pem)", True, "the enrolment at a control centre"),
    "page": Place(tokens_folder, r"tokens\.json", True, "logins of the page"),
}


class StoredFile(BaseModel):
    """One file of a backup."""

    model_config = ConfigDict(extra="forbid")
    name: Annotated[str, Field(pattern=r"^[a-z]{1,10}/[a-z0-9_.-]{1,90}$")]
    sha256: Annotated[str, Field(pattern=r"^[0-9a-f]{64}$")]
    mode: Annotated[int, Field(ge=0, le=0o7777)]


class About(BaseModel):
    """What a backup says of itself."""

    model_config = ConfigDict(extra="ignore")
    version: Annotated[str, Field(max_length=40)]
    vehicle: Annotated[str, Field(max_length=80)]
    utc: Annotated[str, Field(max_length=40)]
    settings_sha256: Annotated[str, Field(pattern=r"^[0-9a-f]{64}$")]
    files: Annotated[list[StoredFile], Field(max_length=FILES)]


def backup(
    output: Annotated[
        Path | None, typer.Option("-o", "--output", metavar="FILE", help="Zip file to write; not given: by the time.")
    ] = None,
    *,
    without_keys: Annotated[
        bool,
        typer.Option("--without-keys", help="Leave out keys, enrolment and logins: no one can act as this unit by it."),
    ] = False,
    vehicle: VehicleOption = None,
) -> int:
    """Keep what makes this unit this unit: its settings, what it has learned, its keys, enrolment and logins.

    Recordings, and the ledger of a road-side unit, are not part of it: copy their folders. Whoever has the file can
    sign as this unit; keep it as a key is kept, or use `--without-keys`. Passwords in settings are in either.

    Examples:
    [bold]sudo obu backup -o truck-07.zip[/]
    [bold]obu backup --without-keys[/]
    """
    state, unit = state_dir(), load_vehicle(vehicle)
    path = output or Path(f"obu-backup-{datetime.now(UTC):%Y%m%dT%H%M%SZ}.zip")
    if path.exists():
        raise UserError(f"{path} exists already; name another file with --output, or remove it")
    stored: list[StoredFile] = []
    contents: list[bytes] = []
    for name, source in _present(state, secrets=not without_keys):
        try:
            content, mode = read_plain(source, FILE_BYTES)
        except OSError as error:
            raise UserError(f"cannot read {source}: {error.strerror}; run the command with `sudo`") from error
        except SizeExceeded as error:
            raise UserError(f"cannot keep {source}: {error}; move it away, it is no file of the unit") from error
        stored.append(StoredFile(name=name, sha256=hashlib.sha256(content).hexdigest(), mode=mode))
        contents.append(content)
    text = unit.text.encode()
    about = About(
        version=VERSION, vehicle=unit.name, utc=datetime.now(UTC).isoformat(timespec="seconds"),
        settings_sha256=hashlib.sha256(text).hexdigest(), files=stored,
    )  # fmt: skip
    try:
        with (
            os.fdopen(os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600), "wb") as file,
            zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as archive,
        ):
            archive.writestr(ABOUT, about.model_dump_json(indent=1))
            archive.writestr(SETTINGS, text)
            for one, content in zip(stored, contents, strict=True):
                archive.writestr(one.name, content)
    except OSError as error:
        path.unlink(missing_ok=True)
        raise UserError(f"cannot write {path}: {error.strerror}; make room or name another file with -o") from error
    _report(one.name for one in stored)
    print(f"wrote {path}: settings and {len(stored)} files; recordings and files that settings name are not in it")
    return 0


def restore(
    file: Annotated[Path, typer.Argument(help="A file of `obu backup`.")],
    *,
    check: Annotated[bool, typer.Option("--check", help="Only look whether it is whole, and what it holds.")] = False,
    vehicle: VehicleOption = None,
) -> int:
    """Make this machine the unit of a backup; what it replaces is kept beside it, with `.old` at the end.

    The unit has to stand still: `sudo systemctl stop obu.target`. Do not run the machine of the backup and this one at
    once with one key: what they sign cannot be told apart.

    Examples:
    [bold]obu restore truck-07.zip --check[/]
    [bold]sudo obu restore truck-07.zip[/]
    """
    about, text, files = read_backup(file)
    print(f"{file}: unit {about.vehicle}, version {about.version}, of {about.utc}")
    _report(name for name, _, _ in files)
    if check:
        return 0
    state, target = state_dir(), _vehicle_path(vehicle)
    _insist_on_rest(state)
    try:
        state.mkdir(parents=True, exist_ok=True)
        replace(target, text.encode(), 0o644)
        _set_aside_changes(state)
        for name, content, mode in files:
            place, _, rest = name.partition("/")
            replace(PLACES[place].folder(state) / rest, content, mode)
    except OSError as error:
        raise UserError(
            f"cannot write {error.filename}: {error.strerror}; run the command with `sudo`, or make room, and repeat it"
        ) from error
    print(f"restored; the settings are in {target}. Start the unit, and look at it with `obu doctor`")
    return 0


def reset(
    *,
    everything: Annotated[
        bool,
        typer.Option("--all", help="Also delete keys, enrolment and recordings, as before the unit is passed on."),
    ] = False,
    yes: Annotated[bool, typer.Option("--yes", help="Do not ask.")] = False,
    vehicle: VehicleOption = None,
) -> int:
    """Put the unit back to how it was delivered: shipped settings, no logins, nothing learned.

    Recordings, keys and the enrolment stay, and the vehicle's file as `.old`, unless `--all` is given.

    Examples:
    [bold]sudo obu reset[/]
    [bold]sudo obu reset --all --yes[/]
    """
    state, target = state_dir(), _vehicle_path(vehicle)
    _insist_on_rest(state)
    units = _readable(vehicle, target)
    delivered = _delivered(units[0] if units else None, target)
    doomed = [path for path in _learned(state, everything=everything) if _is_there(path)]
    if everything:
        doomed += [path for path in (*_whole(state, units), target.with_name(f"{target.name}.old")) if _is_there(path)]
    for path in dict.fromkeys(doomed):
        print(f"deletes {path}" + (f", a link: what is in {path.readlink()} stays" if path.is_symlink() else ""))
    print(f"replaces {target} by {delivered.name}")
    if not units:
        print(f"{target} cannot be read: a folder of recordings that it names elsewhere is not known, and stays")
    if not yes and not typer.confirm("Reset the unit?"):
        print("nothing was changed")
        return 1
    try:
        content = delivered.read_bytes()
        for path in dict.fromkeys(doomed):
            delete(path)
        replace(target, content, 0o644, keep_old=not everything)
    except OSError as error:
        raise UserError(f"cannot delete {error.filename}: {error.strerror}; run the command with `sudo`") from error
    print("reset; start the unit, and log in with `obu token show-link`")
    return 0


LIGHT = ("state", "page")  # places that every reset empties


def _learned(state: Path, *, everything: bool) -> Iterator[Path]:
    """Files of the places that a reset empties, with what was replaced of them, and what the page has written."""
    for place, rule in PLACES.items():
        if everything or place in LIGHT:
            yield from (path for path in _listed(rule.folder(state)) if re.fullmatch(rule.names + LEFT, path.name))
    yield from state.glob("status.*.jsonl")
    yield settings_folder(state)


def _whole(state: Path, units: list[VehicleFile]) -> Iterator[Path]:
    """Folders and files of a unit besides: drives, reports, logs, the ledger, and backups of the installer."""
    yield from (state / name for name in ("recordings", "jobs", "toll", "logs", "ends", "uplink", "set_up.json"))
    for unit in units:
        named = state / str(unit.tables.get("monitoring.recorder", {}).get("folder", "recordings"))
        if not named.resolve().is_relative_to(state.resolve() / "recordings"):
            # Another folder may hold files of others: those of the recorder go.
            yield from (path for path in _listed(named) if ".mcap" in path.suffixes)
        ledger = state / str(unit.tables.get("monitoring.ledger", {}).get("file", "toll/ledger.sqlite"))
        yield from (ledger.with_name(f"{ledger.name}{end}") for end in ("", "-wal", "-shm", "-journal"))
    if state == STATE:
        yield BACKUPS


def _is_there(path: Path) -> bool:
    return path.is_symlink() or path.exists()


def read_backup(file: Path) -> tuple[About, str, list[tuple[str, bytes, int]]]:
    """Read and check a backup: what it says of itself, the settings, and name, content and rights of each file.

    Raises
    ------
    UserError
        If it is no backup, was changed, or holds what no backup of this version holds.
    """
    try:
        with zipfile.ZipFile(file) as archive:
            about = About.model_validate_json(_content(archive, ABOUT, ABOUT_BYTES))
            text = _content(archive, SETTINGS, TOML_BYTES)
            _insist(hashlib.sha256(text).hexdigest() == about.settings_sha256, f"{SETTINGS} was changed")
            files = []
            for one in about.files:
                place, _, name = one.name.partition("/")
                known = place in PLACES and re.fullmatch(PLACES[place].names, name)
                _insist(bool(known), f"it has a file {one.name!r}, which this version does not know")
                content = _content(archive, one.name, FILE_BYTES)
                _insist(hashlib.sha256(content).hexdigest() == one.sha256, f"{one.name} was changed")
                files.append((one.name, content, one.mode & MODES))
            settings = text.decode()
    except FileNotFoundError as error:
        raise UserError(f"there is no file {file}; `obu backup` writes one") from error
    except OSError as error:
        raise UserError(f"cannot read {file}: {error.strerror or error}; run the command with `sudo`") from error
    except (zipfile.BadZipFile, KeyError, ValueError, NotImplementedError, RuntimeError, EOFError) as error:
        reason = "its about.json is not that of a backup" if isinstance(error, ValidationError) else error
        raise UserError(f"{file} is no whole backup: {reason}; take another copy of it") from error
    parse_vehicle(settings, f"{file}: {SETTINGS}")
    return about, settings, files


def _insist(condition: bool, reason: str) -> None:
    if not condition:
        raise ValueError(reason)


def _content(archive: zipfile.ZipFile, name: str, most: int) -> bytes:
    """Content of a member of at most `most` bytes; what it says of its size is not believed."""
    with archive.open(name) as file:
        content = file.read(most + 1)
    _insist(len(content) <= most, f"{name} has more than {most} bytes")
    return content


def _present(state: Path, *, secrets: bool) -> Iterator[tuple[str, Path]]:
    """Names in a backup and paths of the files that are there."""
    for place, rule in PLACES.items():
        if rule.secret and not secrets:
            continue
        yield from (
            (f"{place}/{path.name}", path)
            for path in _listed(rule.folder(state))
            if is_plain(path) and re.fullmatch(rule.names, path.name)
        )


def _listed(folder: Path) -> list[Path]:
    try:
        return sorted(folder.iterdir()) if folder.is_dir() else []
    except OSError as error:
        raise UserError(f"cannot read {folder}: {error.strerror}; run the command with `sudo`") from error


def _report(names: Iterator[str]) -> None:
    found = [name.split("/")[0] for name in names]
    for place, rule in PLACES.items():
        print(f"{rule.meaning}: {found.count(place) or 'nothing'}")


def _set_aside_changes(state: Path) -> None:
    """Let the restored file hold: changes of the page were made over another one."""
    changed = settings_folder(state) / SETTINGS
    if changed.exists():
        changed.replace(changed.with_name(f"{SETTINGS}.old"))


def _vehicle_path(vehicle: Path | None) -> Path:
    named = vehicle or (Path(os.environ["OBU_VEHICLE"]) if os.environ.get("OBU_VEHICLE") else None)
    if named is None:
        raise UserError("which vehicle's file? Give it with --vehicle, or in OBU_VEHICLE")
    return named


def _readable(vehicle: Path | None, target: Path) -> list[VehicleFile]:
    """The settings that hold, and those of the vehicle's file: each that can be read."""
    found = []
    for name in (vehicle, target):
        try:
            found.append(load_vehicle(name))
        except UserError:
            continue  # a reset is also for settings that are broken
    return found


def _delivered(unit: VehicleFile | None, target: Path) -> Path:
    """The shipped file of the kind of a unit; of one whose settings are broken, by what their text looks like."""
    try:
        rsu, simulated = (unit.role == "rsu", "sensors.simulator" in unit.tables) if unit else (None, False)
    except UserError:
        rsu = None
    if rsu is None:
        try:
            text = read_plain(target, TOML_BYTES)[0].decode(errors="replace")
        except (OSError, SizeExceeded):
            text = ""
        rsu = re.search(r"""^\s*role\s*=\s*["']rsu""", text, re.M) is not None
        simulated = re.search(r"^\s*\[sensors\.simulator\b", text, re.M) is not None
    kind = "rsu" if rsu else "simulated" if simulated else "pi"
    return shipped(Path(f"deploy/vehicles/{kind}.toml"))


def _insist_on_rest(state: Path) -> None:
    """Raise `UserError` while the unit of a state folder runs: it would write over what is restored."""
    address = page_of(state)
    if address is None:
        return
    try:
        with urllib.request.urlopen(f"{address}/api/alive", timeout=ANSWER_S):  # the unit's own address
            pass
    except urllib.error.HTTPError:
        pass  # it answers: it runs
    except (OSError, ValueError):
        return
    raise UserError("the unit runs; stop it first: `sudo systemctl stop obu.target`, or end `obu up`")

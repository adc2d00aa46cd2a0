"""`obu support`: one file with what somebody who helps needs to know of a unit, and without secrets."""

import json
import os
import platform
import re
import shutil
import sys
import time
import urllib.error
import urllib.request
import zipfile
from collections.abc import Iterator
from datetime import UTC, datetime
from importlib import metadata
from pathlib import Path
from typing import Annotated

import typer

from shared import VERSION
from shared.errors import BadRecording, UserError
from shared.recording import Recording, RecordingWriter
from shared.recording.writer import without_users
from shared.runtime.config import LOGIN_VARIABLE, VehicleFile, load_vehicle, page_of, state_dir

from .doctor import findings

VehicleOption = Annotated[
    Path | None, typer.Option("--vehicle", metavar="FILE", help="The vehicle's TOML file; without it OBU_VEHICLE.")
]
NS = 1_000_000_000
MINUTE_S = 60.0
LOG_BYTES = 256 * 1024  # of the end of each log
LOGS = 40  # files
ANSWER_S = 5.0
NOT_HEALTHY = 503  # of an answer that tells what is not
# Settings whose value is a secret as a whole, wherever they stand; addresses lose their users and passwords.
SECRET = re.compile(r"(?im)^(\s*[\w.-]*(?:password|secret|token|passphrase)[\w.-]*\s*=\s*)(?!\[|\{).*$")
READ_ME = """What `obu support` has collected. Nothing was sent: look through it before you pass it on.

about.json       versions, machine, free room
doctor.txt       checks of this machine, the configuration and the running unit, with remedies
vehicle.toml     settings that hold, without users, passwords and other secrets
health.json      topics and processes against their deadlines, and outages, as the page told them; a page that asks
                 for a login tells nothing (401) unless OBU_TOKEN has one
logs/            the ends of the processes' logs, where they are files
last.mcap        the last minutes of the newest recording: it holds where the vehicle was
"""


def support(
    output: Annotated[
        Path | None, typer.Option("-o", "--output", metavar="FILE", help="Zip file to write; not given: by the time.")
    ] = None,
    minutes: Annotated[
        float, typer.Option(min=0.0, max=60.0, metavar="MINUTES", help="Of the newest recording; 0: none of it.")
    ] = 5.0,
    vehicle: VehicleOption = None,
) -> int:
    """Collect what somebody who helps needs: checks, settings without secrets, health, logs, the last minutes.

    Nothing is sent. The recording holds where the vehicle was: `--minutes 0` leaves it out.

    Examples:
    [bold]obu support[/]
    [bold]obu support --minutes 0 -o truck-07.zip[/]
    """
    state = state_dir()
    path = output or Path(f"obu-support-{datetime.now(UTC):%Y%m%dT%H%M%SZ}.zip")
    if path.exists():
        raise UserError(f"{path} exists already; name another file with --output, or remove it")
    try:
        with zipfile.ZipFile(path, "x", zipfile.ZIP_DEFLATED) as archive:
            archive.writestr("README.txt", READ_ME)
            for name, content in _texts(vehicle, state):
                archive.writestr(name, content)
                print(f"{name}: {len(content.encode())} bytes")
            if minutes:
                print(_recording(archive, path.absolute().parent, _newest(state, vehicle), minutes * MINUTE_S))
    except OSError as error:
        path.unlink(missing_ok=True)
        raise UserError(f"cannot write {path}: {error.strerror}; make room or name another file with -o") from error
    print(f"wrote {path} ({path.stat().st_size / 1e6:.1f} MB); nothing was sent")
    return 0


def without_secrets(text: str) -> str:
    """Text of a vehicle's file without users and passwords of addresses, and without values that are secrets."""
    return SECRET.sub(r'\1"left out"', without_users(text))


def about(state: Path) -> dict[str, object]:
    """Versions, and what this machine is."""
    usage = shutil.disk_usage(state)
    packages = sorted(
        f"{one.metadata['Name']} {one.version}" for one in metadata.distributions() if one.metadata["Name"]
    )
    return {
        "obu": VERSION, "python": sys.version.split()[0], "system": platform.platform(), "machine": platform.machine(),
        "processors": os.cpu_count(), "free_bytes": usage.free, "total_bytes": usage.total,
        "utc": datetime.now(UTC).isoformat(timespec="seconds"), "packages": packages,
    }  # fmt: skip


def _texts(vehicle: Path | None, state: Path) -> Iterator[tuple[str, str]]:
    yield "about.json", json.dumps(about(state), indent=1)
    lines = []
    for finding in findings(vehicle, probe=False):
        lines.append(f"{'ok ' if finding.ok else 'NO '} {finding.what}")
        lines += [] if finding.ok else [f"    -> {finding.remedy}"]
    yield "doctor.txt", without_users("\n".join(lines)) + "\n"
    try:
        yield "vehicle.toml", without_secrets(load_vehicle(vehicle).text)
    except UserError as error:
        yield "vehicle.toml", f"# {error}\n"
    yield "health.json", _health(state)
    for path in _logs(state):
        yield f"logs/{path.name}", _end_of(path)


def _health(state: Path) -> str:
    """What the page of the running unit tells, or why it tells nothing."""
    address = page_of(state)
    if address is None:
        return json.dumps({"error": "no unit whose page is known runs with this state folder"})
    found: dict[str, object] = {}
    login = {"Authorization": f"Bearer {token}"} if (token := os.environ.get(LOGIN_VARIABLE)) else {}
    for name in ("health", "outages", "trust"):
        request = urllib.request.Request(f"{address}/api/{name}", headers=login)
        try:
            with urllib.request.urlopen(request, timeout=ANSWER_S) as answer:  # the unit's own address
                found[name] = json.load(answer)
        except urllib.error.HTTPError as error:
            found[name] = json.load(error) if error.code == NOT_HEALTHY else {"error": error.code}
        except (OSError, ValueError) as error:
            found[name] = {"error": str(error)}
    return json.dumps(found, indent=1)


def _logs(state: Path) -> list[Path]:
    folders = (state / "logs", state / "demo" / "logs")
    return sorted(path for folder in folders if folder.is_dir() for path in folder.glob("*.log"))[:LOGS]


def _end_of(path: Path) -> str:
    try:
        with path.open("rb") as file:
            file.seek(max(0, path.stat().st_size - LOG_BYTES))
            return without_users(file.read(LOG_BYTES).decode("utf-8", "replace"))
    except OSError as error:
        return f"cannot be read: {error.strerror}\n"


def _recording(archive: zipfile.ZipFile, folder: Path, newest: Path | None, span_s: float) -> str:
    """Put the end of the newest recording into the archive, by a draft in a folder; say what became of it."""
    if newest is None:
        return "last.mcap: there is no recording"
    part = folder / f".obu-support-{os.getpid()}-{time.time_ns()}.mcap"
    try:
        count = _cut(newest, part, span_s)
        archive.write(part, "last.mcap", zipfile.ZIP_STORED)
        return f"last.mcap: {count} messages of {newest.name}, {part.stat().st_size} bytes"
    except (BadRecording, OSError) as error:
        return f"last.mcap: left out: {error}"
    finally:
        part.unlink(missing_ok=True)


def _newest(state: Path, vehicle: Path | None) -> Path | None:
    try:
        file: VehicleFile | None = load_vehicle(vehicle)
    except UserError:
        file = None
    table = file.tables.get("monitoring.recorder", {}) if file else {}
    folder = state / str(table.get("folder", "recordings"))
    return max(folder.glob("*.mcap"), key=lambda path: path.stat().st_mtime, default=None)


def _cut(source: Path, target: Path, span_s: float) -> int:
    """Copy the last seconds of a recording; the number of messages."""
    with Recording(source) as recording:
        last_ns = max((envelope.received_ns for envelope in recording), default=0)
        writer = RecordingWriter(target, copied_by="obu support")
        count = 0
        for envelope in recording:
            if envelope.received_ns > last_ns - span_s * NS:
                writer.write(envelope)
                count += 1
        writer.close()
    return count

"""Digests of what each process reads of a vehicle's file: with another digest it would run with other settings."""

import hashlib
import json

from ..processes import BY_NAME
from ..runtime.config import Section, VehicleFile, settings_model

DIGITS = 16
# Beginnings of the sections that a process reads beside its own: the page says whether all data are simulated, and
# lists the recordings.
READS = {"monitoring.status": ("sensors.", "monitoring.recorder")}
WHOLE = ("monitoring.recorder",)  # writes the whole file into each recording


def digest_for(process: str, file: VehicleFile, section: Section) -> str:
    """Digest of the settings of a process, of the facts of the vehicle that it reads, and of what else it looks at."""
    read: list[object] = [file.name, section.model_dump(mode="json")]
    if BY_NAME[process].observes_all:
        read.append(sorted(file.processes))
    if others := READS.get(process):
        read.append({name: table for name, table in sorted(file.tables.items()) if name.startswith(others)})
    if process in WHOLE:
        read.append(file.text)
    return hashlib.sha256(json.dumps(read, sort_keys=True, default=str).encode()).hexdigest()[:DIGITS]


def digest_in(process: str, file: VehicleFile) -> str:
    """Digest of what a process reads of a file; raises `ConfigError` for an invalid section."""
    return digest_for(process, file, file.section(process, settings_model(process)))

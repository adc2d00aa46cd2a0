"""Makes the demo's vehicle report to a control centre of this machine."""

from pathlib import Path

from shared.errors import UserError
from shared.evidence import EvidenceError, KeyFile
from shared.fleet.enrolling import enrol
from shared.fleet.identity import identity_folder

from ..centre.vehicles import token_for

TENANT = "demo"


def join(centre: Path, vehicle: str, state: Path, keys: Path) -> None:
    """Enrol the demo's vehicle at the centre of a folder, which `obu centre up` runs; raises `UserError`."""
    url, token = token_for(centre, TENANT, vehicle)
    try:
        enrol(url, token, vehicle, identity_folder(state), KeyFile(keys).signer())
    except EvidenceError as error:
        raise UserError(str(error)) from error

"""The certificate of an installation: what a drive has shown and the settings that hold, signed by the unit."""

import json
import time
from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated

import typer

from services.core.fusion.set_up.survey.findings import LIMITS, Finding
from shared import VERSION
from shared.bounded import load_json, read_bytes
from shared.errors import UserError
from shared.evidence import EvidenceError, KeyFile, keys_folder
from shared.evidence.statement import KEY, PUBLIC_KEY, SIGNATURE, is_genuine, printable, signed
from shared.runtime.config import state_dir

from ..evidence_key import KeyOption, accepted_keys
from .drive import Drive

KIND = "installation"
FILE_BYTES = 100_000
LINE = 96  # characters of a line of the printed page


def write_certificate(path: Path, drive: Drive, findings: list[Finding]) -> None:
    """Write a certificate; raises `UserError`.

    Parameters
    ----------
    path : Path
        Its file: of the name's end `.pdf` a page to print, otherwise JSON.
    drive : Drive
        That was surveyed, with the settings that hold.
    findings : list of Finding
        Of the survey.
    """
    try:
        fields = signed(KIND, _fields(drive, findings), KeyFile(keys_folder(state_dir())).signer())
    except EvidenceError as error:
        raise UserError(str(error)) from error
    try:
        if path.suffix == ".pdf":
            _print(path, fields)
        else:
            path.write_text(json.dumps(fields, indent=1), encoding="utf-8")
    except OSError as error:
        raise UserError(f"cannot write {path}: {error.strerror}; choose another path") from error


def verify_set_up(
    certificate: Annotated[Path, typer.Argument(help="Certificate (JSON) of `obu set-up --certificate`.")],
    *,
    key: KeyOption = None,
) -> int:
    """Check the signature of a certificate of an installation, and print what it says.

    It ends with 1 if the certificate is not genuine, or of a key that is not known.

    Example: [bold]obu verify-set-up van.json --key van.pub[/]
    """
    try:
        found = load_json(read_bytes(certificate, FILE_BYTES), FILE_BYTES)
    except (OSError, ValueError) as error:
        raise UserError(f"cannot read {certificate}: {error}; name a file of `obu set-up --certificate`") from error
    if not isinstance(found, dict) or not all(isinstance(value, str) for value in found.values()):
        raise UserError(f"{certificate} is no certificate; name a file of `obu set-up --certificate`")
    for name, value in found.items():
        if name != SIGNATURE:
            print(f"{printable(name)}: {printable(value, 4 * LINE)}")
    if not is_genuine(KIND, found):
        print("the signature does not fit: it was changed, or signed by something else")
        return 1
    made_ns = round(datetime.fromisoformat(found["made_utc"]).timestamp() * 1e9)
    if not accepted_keys(key).accepts(found[KEY], found[PUBLIC_KEY], made_ns):
        print(f"signed by key {printable(found[KEY])}, which is not known, or was not in use then: --key names it")
        return 1
    print("the signature is that of a known key")
    return 0


def _fields(drive: Drive, findings: list[Finding]) -> dict[str, str]:
    facts, settings = drive.vehicle.facts, drive.settings
    stated = {
        "vehicle.imu.body_from_sensor": facts.imu.body_from_sensor,
        "vehicle.gnss.lever_arm_body_m": facts.gnss.lever_arm_body_m,
        "core.fusion.gnss.delay_s": settings.gnss.delay_s,
        "core.fusion.gnss.velocity_delay_s": settings.gnss.velocity_delay_s,
        "core.fusion.odometer.scale": settings.odometer.scale,
    }
    rows = {
        one.quantity.value: f"{one.verdict.value}"
        + ("" if one.sd is None else f", off by {one.difference:.3g} ± {one.sd:.2g} {LIMITS[one.quantity].unit}")
        for one in findings
    }
    return {
        "vehicle": facts.name, "recording": drive.name, "program": VERSION,
        "made_utc": datetime.fromtimestamp(time.time(), UTC).isoformat(timespec="seconds"),
        **{f"setting {name}": json.dumps(value) for name, value in stated.items()},
        **{f"finding {name}": text for name, text in rows.items()},
    }  # fmt: skip


def _print(path: Path, fields: dict[str, str]) -> None:
    """One page A4 with every field, the signature too, from which the JSON can be typed again."""
    from matplotlib.backends.backend_pdf import FigureCanvasPdf
    from matplotlib.figure import Figure

    figure = Figure(figsize=(8.27, 11.69))
    FigureCanvasPdf(figure)
    figure.text(0.08, 0.95, f"Installation of {printable(fields['vehicle'])}", fontsize=18)
    lines = []
    for name, value in fields.items():
        text = f"{name}: {printable(value, 8 * LINE)}"
        lines += [text[first : first + LINE] for first in range(0, len(text), LINE)]
    figure.text(0.08, 0.92, "\n".join(lines), fontsize=8, family="monospace", va="top", linespacing=1.7)
    figure.savefig(path, format="pdf", metadata={"CreationDate": None})

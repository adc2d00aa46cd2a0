"""`obu set-up`: what a drive shows of mounting, lever arm, delays and scale, and the settings that follow."""

import json as json_module
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path
from typing import Annotated

import typer
from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table

from services.core.fusion.set_up.survey.findings import LIMITS, Finding, Quantity, changes_of, findings_of
from services.core.fusion.set_up.survey.survey import Survey, survey
from shared.messages.base import Message
from shared.messages.navigation import SetUpVerdict
from shared.runtime.config import VehicleFile, parse_vehicle
from shared.settings.edit import checked, edited

from ..output_file import insist_on_new, write_text
from ..progress import progress_on
from .certificate import write_certificate
from .drive import Drive, Shown, innovations_of, motion_of_drive, read

LABELS = {
    Quantity.MOUNTING: "mounting of the IMU", Quantity.LEVER_ARM: "lever arm of the antenna",
    Quantity.DELAY: "delay of fixes", Quantity.VELOCITY_DELAY: "delay of velocities beyond it",
    Quantity.ODOMETER_SCALE: "scale of the odometer",
}  # fmt: skip


def set_up(
    recording: Annotated[Path, typer.Argument(help="Recording of a drive with bends, braking and some minutes.")],
    *,
    vehicle: Annotated[
        Path | None, typer.Option("--vehicle", metavar="FILE", help="Vehicle TOML file; default: the recorded one.")
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option("-o", "--out", metavar="FILE", help="Write the vehicle's file with the proposed settings."),
    ] = None,
    compare: Annotated[
        bool, typer.Option("--compare", help="Solve the drive with the settings as they are and as proposed, as well.")
    ] = False,
    certificate: Annotated[
        Path | None,
        typer.Option("--certificate", metavar="FILE", help="Write what was found, signed: JSON, or a page in PDF."),
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print the result as one JSON object.")] = False,
) -> int:
    """Measure mounting, lever arm, delays and odometer scale from a drive, and propose settings.

    What the drive does not show well enough is named, and nothing is proposed for it. Drive straight with braking and
    bends to both sides for some minutes, with a fix.

    Examples:
    [bold]obu set-up drive.mcap[/]
    [bold]obu set-up drive.mcap --compare --out vehicle.toml[/]
    [bold]obu set-up drive.mcap --certificate van.json[/]
    """
    _insist_on_places(out, certificate)
    console = Console(stderr=True)
    with progress_on(console) as progress:

        def shown(what: str) -> Shown:
            def track(messages: Iterable[Message], total: int) -> Iterable[Message]:
                return progress.track(messages, total=total, description=what)

            return track

        drive = read(recording, vehicle, console)
        found = survey(motion_of_drive(drive, shown("reading the drive")), drive.settings)
        findings = findings_of(found, drive.settings)
        changes = changes_of(findings)
        innovations = None
        if compare and changes:
            before = innovations_of(drive, drive.vehicle, shown("as it is"))
            innovations = before, innovations_of(drive, changed(drive.vehicle, changes), shown("as proposed"))
    if out is not None:
        _write(out, drive.vehicle, changes)
    if certificate is not None:
        write_certificate(certificate, drive, findings)
    if as_json:
        print(json_module.dumps(document(drive, found, findings, innovations)))
        return 0
    _print(findings, innovations)
    print(f"wrote {out}" if out is not None else "With --out FILE the vehicle's file is written with these settings.")
    return 0


def _insist_on_places(out: Path | None, certificate: Path | None) -> None:
    for path, option in ((out, "--out"), (certificate, "--certificate")):
        if path is not None:
            insist_on_new(path, option)


def _write(path: Path, vehicle: VehicleFile, changes: dict[str, object]) -> None:
    text = edited(vehicle.text, changes)
    checked(text, str(path))
    write_text(path, text)


def changed(vehicle: VehicleFile, changes: dict[str, object]) -> VehicleFile:
    """A vehicle's file with other settings; the samples of a recording keep the axes that they were recorded in."""
    after = parse_vehicle(edited(vehicle.text, changes))
    return replace(after, samples_mounting=vehicle.samples_mounting)


def document(
    drive: Drive, found: Survey, findings: list[Finding], innovations: tuple[dict[str, float], dict[str, float]] | None
) -> dict[str, object]:
    """Result as JSON."""
    adjusted = found.adjusted
    return {
        "recording": drive.name,
        "arcs": adjusted.arcs if adjusted else 0,
        "bends": adjusted.bends if adjusted else 0,
        "findings": [
            {
                "quantity": one.quantity.value, "verdict": one.verdict.value, "difference": one.difference,
                "sd": one.sd, "limit": LIMITS[one.quantity].sd, "unit": LIMITS[one.quantity].unit,
                "known": round(one.known, 3), "changes": dict(one.changes),
            }
            for one in findings
        ],
        "innovations": None if innovations is None else {"before": innovations[0], "after": innovations[1]},
    }  # fmt: skip


def _print(findings: list[Finding], innovations: tuple[dict[str, float], dict[str, float]] | None) -> None:
    table = Table(box=SIMPLE_HEAD, pad_edge=False, show_edge=False)
    for heading in ("", "found", "off by", "1 sigma", "known from"):
        table.add_column(heading, overflow="fold")
    for one in findings:
        unit = "" if LIMITS[one.quantity].unit == "-" else f" {LIMITS[one.quantity].unit}"
        numbers = ["-" if value is None else f"{value:.3g}{unit}" for value in (one.difference, one.sd)]
        table.add_row(LABELS[one.quantity], _said(one), *numbers, f"{LIMITS[one.quantity].sd:g}{unit}")
    Console().print(table)
    for one in findings:
        for name, value in one.changes.items():
            print(f"{name} = {json_module.dumps(value)}")
    if innovations is not None:
        before, after = innovations
        for kind, size in before.items():
            print(f"innovations of {kind}, RMS: {size:.3f} -> {after.get(kind, float('nan')):.3f}")


def _said(one: Finding) -> str:
    if one.verdict is SetUpVerdict.UNKNOWN:
        return "not shown by this drive" if one.sd is None else "not known well enough"
    return {SetUpVerdict.AGREES: "agrees", SetUpVerdict.CONTRADICTS: "differs"}[one.verdict]

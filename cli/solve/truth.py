"""Selects the truth that a solution is compared with."""

import csv
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from services.core.fusion.process import Config
from shared.bounded import SizeExceeded, checked
from shared.errors import UserError
from shared.messages.gnss import CarrierSolution, GnssFix
from shared.messages.navigation import TruthState
from shared.runtime.config import VehicleFile

from ..import_drive.readers.table import read_table
from .inputs import Inputs, all_fixes
from .reference_track import ATTITUDE, POSITION, VELOCITY, Reference, from_columns, from_fixes, from_states


def given_truth(
    provenance: Mapping[str, str], states: Sequence[TruthState], truth: str | None
) -> tuple[Reference | None, str]:
    """Select the truth: the requested one, otherwise the one stated or held by the recording.

    The second item is "fixes" if the GNSS fixes are the truth, "perhaps" if they are used when RTK-fixed, and "none"
    otherwise.
    """
    word = truth or provenance.get("truth_is") or ("recorded" if states else "perhaps")
    if word in ("none", "fixes", "perhaps"):
        return None, word
    if word != "recorded":
        return truth_file(Path(word)), "none"
    reference = from_states(states, at_antenna=provenance.get("truth_at") == "antenna")
    quantities = provenance.get("truth_quantities", "") if truth is None else ""
    return reference.only(quantities.split(",")) if quantities else reference, "none"


def any_fixed(fixes: Sequence[GnssFix]) -> bool:
    """Whether a fix has integer ambiguities."""
    return any(fix.carrier_solution == CarrierSolution.FIXED for fix in fixes)


def truth_of_fixes(fixes: Sequence[GnssFix], config: Config) -> Reference:
    """Make the truth of the RTK-fixed fixes, with the delays of the vehicle's file."""
    return from_fixes(fixes, delay_s=config.gnss.delay_s, velocity_delay_s=config.gnss.velocity_delay_s)


def insist_on_fixes(inputs: Inputs, vehicle: VehicleFile) -> None:
    """Raise `UserError` where the fixes cannot be the truth, before a recording is solved for it."""
    truth_of_fixes(all_fixes(inputs, vehicle), vehicle.section("core.fusion", Config))


def truth_file(path: Path) -> Reference:
    """Read a CSV file with columns named as in solution.csv."""
    try:
        with path.open(newline="", encoding="utf-8") as file:
            rows = csv.reader(checked(file))
            header = next(rows, [])
            clock = "utc_s" if "utc_s" in header else "sampled_ns"
            known = [name for name in (*POSITION, *VELOCITY, *ATTITUDE) if name in header]
            table = read_table(rows, header, [clock, *known], path.name)
    except (OSError, UnicodeDecodeError, csv.Error, SizeExceeded) as error:
        reason = error.strerror if isinstance(error, OSError) else "not a CSV file"
        raise UserError(
            f"cannot read the truth {path}: {reason}; --truth is fixes, recorded, none or a CSV file"
        ) from error
    if not known:
        raise UserError(f"{path} has none of the columns {', '.join(POSITION)}; docs/reference/metrics.md lists them")
    stamps = np.round(table[clock] * (1e9 if clock == "utc_s" else 1.0)).astype(np.int64)
    order = np.argsort(stamps, kind="stable")
    return from_columns(path.name, stamps[order], {name: table[name][order] for name in known}, in_utc=clock == "utc_s")

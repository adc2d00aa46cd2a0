"""What `obu doctor` says of GNSS corrections: whether they are set up, arrive, and are used by the receiver."""

from collections.abc import Iterator, Sequence

from shared.messages.base import Message
from shared.messages.corrections import CorrectionsState, SourcePhase
from shared.messages.gnss import CarrierSolution, GnssFix
from shared.runtime.config import VehicleFile

Check = tuple[bool, str, str]  # whether it passed, what was checked, the remedy
DRIVER, PARSER = "sensors.corrections", "parsers.corrections"


def corrections_set_up(vehicle: VehicleFile) -> Iterator[Check]:
    """Check that the sections of both processes are there, or none."""
    driver, parser = DRIVER in vehicle.processes, PARSER in vehicle.processes
    if driver or parser:
        missing = PARSER if driver else DRIVER
        yield driver and parser, "corrections: driver and parser", f"add the section [{missing}]"


def corrections(vehicle: VehicleFile, heard: Sequence[Message]) -> Iterator[Check]:
    """Check of a running unit that corrections arrive, each source by itself, and that the receiver uses them.

    Parameters
    ----------
    vehicle : VehicleFile
        The vehicle's file.
    heard : sequence of Message
        Messages of the last seconds, and those that the broker has kept.
    """
    if DRIVER not in vehicle.processes:
        return
    states = [message for message in heard if isinstance(message, CorrectionsState)]
    if not states:
        yield False, "corrections arrive", f"{PARSER} has stated nothing; see its log"
        return
    state = states[-1]
    age = "" if state.frame_age_s is None else f", the last frame {state.frame_age_s:.0f} s ago"
    yield (
        state.active is not None,
        f"corrections arrive{f' from {state.active}{age}' if state.active else ''}",
        state.reason,
    )
    for stream in state.streams:
        if stream.phase in (SourcePhase.WAITING, SourcePhase.REFUSED) and stream.source != state.active:
            yield False, f"corrections from {stream.source}", stream.reason
    fixes = [message for message in heard if isinstance(message, GnssFix)]
    if state.active and fixes:
        used = [_kind(fix) for fix in fixes if _kind(fix)]
        yield (
            bool(used),
            f"the receiver uses corrections{f': {used[-1]}' if used else ''}",
            (
                "it may need a minute and a view of the sky; check that its port takes RTCM 3 or SPARTN, that it "
                "can do RTK, and that the base is within 30 km"
            ),
        )


def _kind(fix: GnssFix) -> str:
    if fix.carrier_solution is not CarrierSolution.NONE:
        return f"RTK {fix.carrier_solution}"
    return "differential" if fix.differential else ""

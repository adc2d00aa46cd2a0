"""What a running unit says of its processes, devices and messages."""

import time
from collections.abc import Iterator, Sequence

from services.controller.mode.process import Config as Controller
from services.controller.mode.unit import has_position
from shared.bus.bus import Bus
from shared.errors import BadPayload, UserError
from shared.messages.base import Message
from shared.messages.gnss import GnssConfiguration, GnssFix, GnssReceiver
from shared.messages.operation import (
    DeviceFound,
    DeviceState,
    MessageKind,
    MessageUse,
    ModeState,
    ProcessHealth,
    ProcessState,
)
from shared.rejects import PAGE, reason_of
from shared.runtime.config import VehicleFile, broker_address, state_dir
from shared.topics import TOPICS

from .corrections import corrections
from .finding import Finding

HEARD = (
    "health/+", "gnss/fix", "gnss/receiver", "gnss/configuration", "mode/state", "device/state", "corrections/state",
)  # fmt: skip
LISTEN_S = 5.0  # a table of messages comes every two seconds, and two of them give rates
SILENCE_TIMEOUT_NS = 3_000_000_000
LISTED = 8
TOLERATED = 0.01  # share of rejected messages of a kind


def unit(vehicle: VehicleFile) -> Iterator[Finding]:
    """Check what the processes of a running unit publish within `LISTEN_S`, and have published before."""
    try:
        healths, heard, now_ns, refused = _listen(vehicle)
    except UserError as error:  # no secret for it
        yield Finding(False, "a user of the bus", str(error))
        return
    if refused:
        yield Finding(False, "a user of the bus", refused)
    elif not healths:
        yield Finding(False, f"processes of {vehicle.name!r}", "start them, or set OBU_VEHICLE to the running vehicle")
    if not healths:
        return
    newest = {health.process: health for health in healths}
    for name in vehicle.processes:
        yield _runs(name, newest.get(name), now_ns)
    yield from found(heard)
    for name in vehicle.processes:
        yield from messages(name, [health for health in healths if health.process == name])
    if {"sensors.gnss", "sensors.simulator"} & set(vehicle.processes):
        yield from receiver(heard, configured=vehicle.section("controller.mode", Controller).configure_gnss)
    yield from (Finding(*correction) for correction in corrections(vehicle, heard))


def _listen(vehicle: VehicleFile) -> tuple[list[ProcessHealth], list[Message], int, str | None]:
    """Messages of the unit, the time, and why the broker refuses to send any."""
    topics = [topic for topic in TOPICS if topic.name in HEARD]
    bus = Bus("observer", vehicle.name, broker_address(), topics, state_dir(), observer=True)
    healths: list[ProcessHealth] = []
    heard: list[Message] = []
    until = time.monotonic() + LISTEN_S
    while time.monotonic() < until:
        for envelope in bus.receive(0.1):
            try:
                message = envelope.decode()
            except BadPayload:
                continue  # a process without a valid health message is reported as not running
            if isinstance(message, ProcessHealth):
                healths.append(message)
            else:
                heard.append(message)
    now_ns, refused = bus.now_ns(), None if bus.connected else bus.last_error
    bus.close()
    return healths, heard, now_ns, refused


def _runs(name: str, health: ProcessHealth | None, now_ns: int) -> Finding:
    if health is None:
        return Finding(False, f"{name} runs", "no health message received; see its log")
    if health.state is not ProcessState.READY or now_ns - health.sent_ns > SILENCE_TIMEOUT_NS:
        state = "no heartbeat" if health.state is ProcessState.READY else health.state
        return Finding(False, f"{name} runs", f"state: {state}; see its log")
    return Finding(not health.last_error, f"{name} runs", f"last error: {health.last_error}")


def found(heard: Sequence[Message]) -> Iterator[Finding]:
    """What each driver has found at its port."""
    newest = {message.source: message for message in heard if isinstance(message, DeviceState)}
    for source, state in sorted(newest.items()):
        said = f": {state.sentence}" if state.found is DeviceFound.WORKING and state.sentence else ""
        remedy = state.sentence or f"{state.device} is {state.found}"
        yield Finding(state.found is DeviceFound.WORKING, f"{source} at {state.device}{said}", remedy)


def messages(process: str, healths: Sequence[ProcessHealth]) -> Iterator[Finding]:
    """What became of the messages of the devices of one parser, with their rates.

    Parameters
    ----------
    process : str
        Its name.
    healths : sequence of ProcessHealth
        Its health messages, in order of time.
    """
    tables = [health for health in healths if health.kinds]
    if not tables:
        return
    first, last = tables[0], tables[-1]
    before = {kind.kind: kind.count for kind in first.kinds}
    span_s = (last.sent_ns - first.sent_ns) * 1e-9
    for use in MessageUse:
        of_use = [kind for kind in last.kinds if kind.use is use]
        if of_use:
            listed = ", ".join(_rate(kind, before, span_s) for kind in of_use[:LISTED])
            more = f" and {len(of_use) - LISTED} more kinds" if len(of_use) > LISTED else ""
            yield Finding(True, f"{process}: {use}: {listed}{more}")
    for kind in last.kinds:
        if kind.rejected:
            few = kind.rejected <= TOLERATED * kind.count
            what = f"{process}: {kind.rejected} of {kind.count} {kind.kind} rejected"
            reason = reason_of(kind.reason or "")
            why = f"{kind.reason}: {reason.meaning}; {reason.remedy}" if reason else f"the reason is {kind.reason}"
            yield Finding(few, f"{what} ({kind.reason})", f"{why}; all reasons: {PAGE}")


def _rate(kind: MessageKind, before: dict[str, int], span_s: float) -> str:
    if span_s <= 0.0:
        return f"{kind.kind} {kind.count}"
    return f"{kind.kind} {(kind.count - before.get(kind.kind, 0)) / span_s:.1f}/s"


def receiver(heard: Sequence[Message], *, configured: bool) -> Iterator[Finding]:
    """Check that the GNSS receiver has a position and, if it should, has taken its configuration.

    Parameters
    ----------
    heard : sequence of Message
        Messages on the topics `HEARD` of the last seconds, and those that the broker has kept.
    configured : bool
        Whether the unit configures the receiver.
    """
    fixes = [message for message in heard if isinstance(message, GnssFix)]
    located = [fix for fix in fixes if has_position(fix)]
    modes = [message for message in heard if isinstance(message, ModeState)]
    said = [message for message in heard if isinstance(message, GnssReceiver)]
    sends = f"; {said[-1].source} sends {', '.join(said[-1].messages) or 'no message'}" if said else ""
    why = f"{modes[-1].reason}{sends if said and said[-1].source not in modes[-1].reason else ''}" if modes else (
        "nothing is heard of it; see the log of parsers.gnss"
    )  # fmt: skip
    yield Finding(bool(located), "the GNSS receiver has a position", why)
    if not configured:
        return
    answers = [message for message in heard if isinstance(message, GnssConfiguration)]
    reason = (answers[-1].reason or "no reason given") if answers else "it has not answered yet"
    read_back = f": {configuration(answers[-1])}" if answers and answers[-1].accepted else ""
    yield Finding(
        bool(answers) and answers[-1].accepted, f"the GNSS receiver has taken its configuration{read_back}",
        f"{reason}; of a receiver that cannot be configured, write configure_gnss = false in [controller.mode]",
    )  # fmt: skip


def configuration(answer: GnssConfiguration) -> str:
    """What was read back from a receiver."""
    parts = [
        " ".join(part for part in (answer.model, answer.firmware, answer.protocol) if part),
        f"a fix every {answer.navigation_period_s:g} s" if answer.navigation_period_s else "",
        answer.dynamic_model or "",
        ", ".join(answer.messages),
        answer.reason or "",  # what the port does not carry
    ]
    return "; ".join(part for part in parts if part)

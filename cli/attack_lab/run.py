"""Runs one case through layers 2 to 4, offline."""

from collections.abc import Iterable, Iterator, Sequence
from itertools import chain, takewhile
from math import radians
from pathlib import Path

from services.core.fusion.process import Config as Fusion
from services.sensors.simulator.process import Config as Simulator
from services.sensors.simulator.scenarios import scenario_of
from services.sensors.simulator.world import DEFAULT_START_NS, Equipment, World
from shared.attacks import BY_NAME as ATTACK_ROWS
from shared.attacks import ScheduledAttack
from shared.errors import UserError
from shared.messages.base import Message
from shared.messages.gnss import GnssFix
from shared.messages.navigation import LastPosition, TruthState
from shared.messages.simulation import AttackName
from shared.processes import BY_NAME
from shared.runtime.config import VehicleFile, load_vehicle
from shared.runtime.offline import OfflineUnit

from ..recordings.common import open_recording, vehicle_of
from ..solve.inputs import arrival_of, inputs_of
from ..solve.reference_track import Reference, from_fixes, from_states
from .cases import Case
from .recorded import attacked, typed
from .timeline import Collector, Timeline

NS = 1_000_000_000
NEIGHBOURS = 4  # V2X neighbours of a drive on which an attack is theirs; others have none
PARKED_S = 3600.0  # from the power-off to the start of a drive that begins with a saved position
PARKED_SD_M, PARKED_YAW_SD_DEG = (1.0, 1.0, 2.0), 1.0
SIMULATED = Path(__file__).parents[2] / "deploy" / "vehicles" / "simulated.toml"


def run(case: Case) -> Timeline:
    """Run a case; the same case gives the same timeline."""
    return _recorded(case) if case.recorded else _simulated(case)


def _simulated(case: Case) -> Timeline:
    return simulated(case.drive, case.seed, case.duration_s, [case.attack] if case.attack else [])


def simulated(drive: str, seed: int, duration_s: float, attacks: Sequence[ScheduledAttack]) -> Timeline:
    """Run the whole unit over a simulated drive with any number of attacks."""
    vehicle = load_vehicle(SIMULATED)
    settings = vehicle.section("sensors.simulator", Simulator)
    neighbours = NEIGHBOURS if any(ATTACK_ROWS[attack.attack].accused == "neighbour" for attack in attacks) else 0
    equipment = Equipment(settings.protocols, settings.mounting_rpy_deg, settings.second_antenna_m, neighbours)
    end_ns = DEFAULT_START_NS + round(duration_s * NS)
    world = World(scenario_of(drive, seed), seed, DEFAULT_START_NS, equipment, attacks)
    arrivals = takewhile(lambda arrival: arrival[0] <= end_ns, world)
    messages: Iterable[Message] = (message for _, message in arrivals)
    if any(map(_is_cold_start, attacks)):
        messages = _after_parking(messages)
    return _collected(OfflineUnit(vehicle), vehicle, messages, (DEFAULT_START_NS, end_ns), None)


def _is_cold_start(attack: ScheduledAttack) -> bool:
    return attack.attack is AttackName.COLD_START


def _after_parking(messages: Iterable[Message]) -> Iterator[Message]:
    """Begin a drive with the position that the unit saved where the vehicle was parked: that of the first truth."""
    arrivals, before = iter(messages), []
    for message in arrivals:
        before.append(message)
        if isinstance(message, TruthState):
            yield _parked(message)
            break
    yield from chain(before, arrivals)


def _parked(truth: TruthState) -> LastPosition:
    if truth.latitude_deg is None or truth.longitude_deg is None or truth.height_ellipsoid_m is None:
        raise ValueError("the simulated truth has a position")
    saved_ns = truth.sampled_ns - round(PARKED_S * NS)
    return LastPosition(
        sampled_ns=saved_ns, utc_ns=saved_ns,
        latitude_deg=truth.latitude_deg, longitude_deg=truth.longitude_deg,
        height_ellipsoid_m=truth.height_ellipsoid_m, yaw_rad=truth.yaw_rad or 0.0,
        position_sd_ned_m=PARKED_SD_M, yaw_sd_rad=radians(PARKED_YAW_SD_DEG), stationary=True,
        earlier_life=True,
    )  # fmt: skip


def _recorded(case: Case) -> Timeline:
    with open_recording(Path(case.drive)) as recording:
        inputs = inputs_of(recording)
        vehicle = vehicle_of(recording, None)
        provenance = recording.metadata.get("provenance", {})
    if not len(inputs):
        raise UserError(f"{case.drive} holds no inputs of a unit; record one with `obu record` or `obu import`")
    start_ns, end_ns = (arrival_of(inputs.envelopes[place]) for place in (0, -1))
    messages = list(typed(vehicle, inputs.messages(vehicle)))
    fusion = vehicle.section("core.fusion", Fusion)
    reference: Reference | None = None
    if provenance.get("truth_is", "recorded") == "recorded" and inputs.truth:
        quantities = provenance.get("truth_quantities", "")
        reference = from_states(inputs.truth)
        reference = reference.only(quantities.split(",")) if quantities else reference
    elif provenance.get("truth_is") == "fixes":
        fixes = [message for message in messages if isinstance(message, GnssFix)]
        reference = from_fixes(fixes, delay_s=fusion.gnss.delay_s, velocity_delay_s=fusion.gnss.velocity_delay_s)
    if case.attack is not None:
        messages = list(attacked(messages, case.attack, start_ns))
    unit = OfflineUnit(vehicle, [name for name in vehicle.processes if BY_NAME[name].layer > 2])
    return _collected(unit, vehicle, messages, (start_ns, end_ns), reference)


def _collected(
    unit: OfflineUnit, vehicle: VehicleFile, messages: Iterable[Message], interval_ns: tuple[int, int],
    reference: Reference | None,
) -> Timeline:  # fmt: skip
    collector = Collector()
    for message in unit.run(messages):
        collector.add(message)
    lever_arm = vehicle.facts.gnss.lever_arm_body_m
    return collector.timeline(interval_ns, lever_arm, reference)

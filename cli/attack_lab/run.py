"""Runs one case through layers 2 to 4, offline."""

from collections.abc import Iterable
from itertools import takewhile
from pathlib import Path

from services.core.fusion.process import Config as Fusion
from services.sensors.simulator.process import Config as Simulator
from services.sensors.simulator.scenarios import scenario_of
from services.sensors.simulator.world import DEFAULT_START_NS, Equipment, World
from shared.errors import UserError
from shared.messages.base import Message
from shared.messages.gnss import GnssFix
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
SIMULATED = Path(__file__).parents[2] / "deploy" / "vehicles" / "simulated.toml"


def run(case: Case) -> Timeline:
    """Run a case; the same case gives the same timeline."""
    return _recorded(case) if case.recorded else _simulated(case)


def _simulated(case: Case) -> Timeline:
    vehicle = load_vehicle(SIMULATED)
    settings = vehicle.section("sensors.simulator", Simulator)
    equipment = Equipment(settings.protocols, settings.mounting_rpy_deg, settings.second_antenna_m)
    attacks = [case.attack] if case.attack else []
    end_ns = DEFAULT_START_NS + round(case.duration_s * NS)
    world = World(scenario_of(case.drive, case.seed), case.seed, DEFAULT_START_NS, equipment, attacks)
    arrivals = takewhile(lambda arrival: arrival[0] <= end_ns, world)
    messages = (message for _, message in arrivals)
    return _collected(OfflineUnit(vehicle), vehicle, messages, (DEFAULT_START_NS, end_ns), None)


def _recorded(case: Case) -> Timeline:
    with open_recording(Path(case.drive)) as recording:
        inputs = inputs_of(recording)
        vehicle = vehicle_of(recording, None)
        provenance = recording.metadata.get("provenance", {})
    if not len(inputs):
        raise UserError(f"{case.drive} holds no inputs of a unit; record one with `obu record` or `obu import`")
    start_ns, end_ns = (arrival_of(inputs.envelopes[place]) for place in (0, -1))
    messages = list(typed(vehicle, inputs.messages()))
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
    lever_arm = vehicle.section("core.fusion", Fusion).gnss.lever_arm_body_m
    return collector.timeline(interval_ns, lever_arm, reference)

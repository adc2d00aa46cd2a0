"""What core.trust makes of healthy drives: it neither takes GNSS away for long nor makes the position worse.

No receiver of these recordings was attacked, and they come from four different inertial sensors. The whole table is
docs/reference/trust-on-drives.md, measured by `make drives-trust`; here are the first minutes of four drives, and a
simulated one with a low-cost IMU, which is always there.
"""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from itertools import takewhile
from pathlib import Path

import numpy as np
import pytest

from cli.import_drive.import_drive import import_drive
from cli.recordings.common import vehicle_of
from cli.solve.inputs import Inputs, arrival_of, inputs_of
from cli.solve.metrics.errors import errors_against
from cli.solve.metrics.integrity import protected
from cli.solve.metrics.trust import Harm, harm_of
from cli.solve.reference_track import Reference, from_fixes, from_states
from cli.solve.track import Track, TrackBuilder
from cli.solve.verdicts import VerdictLog, Verdicts
from services.core.fusion.process import Config
from services.sensors.simulator.drive import Drive, simulate
from shared.messages.base import Message, Tick
from shared.messages.gnss import GnssFix
from shared.messages.navigation import NavigationSolution, NavigationState
from shared.messages.trust import TrustState
from shared.recording import Recording
from shared.runtime.config import VehicleFile, parse_vehicle
from shared.runtime.live import arrival_ns
from shared.runtime.offline import OfflineUnit
from tests.support.data import REPOSITORY, recording
from tests.support.drives.spoofing import inputs as typed_messages

SECOND_NS = 1_000_000_000
SETTLED_NS = 60 * SECOND_NS
LONGEST_EXCLUSION_S = 10.0
HARM, HARM_M = 1.05, 0.1  # an error of a centimetre may grow by more than its twentieth
ABOVE_LEVEL = 1e-3  # the integrity risk


@dataclass(frozen=True)
class DriveRun:
    """Solution, verdicts and fixes of one run."""

    track: Track
    log: VerdictLog
    verdicts: Verdicts | None  # None without core.trust
    fixes: list[GnssFix]


Messages = Callable[[], Iterable[Message]]  # the same ones for each run


def solved(vehicle: VehicleFile, messages: Messages, *, with_trust: bool = True) -> DriveRun:
    processes = [name for name in vehicle.processes if with_trust or name != "core.trust"]
    builder, log, fixes = TrackBuilder(), VerdictLog(), list[GnssFix]()
    arrivals = list[int]()

    def fed() -> Iterator[Message]:
        for message in messages():
            arrivals.extend(stamp for stamp in (arrival_ns(message),) if stamp is not None)
            yield message

    for message in OfflineUnit(vehicle, processes).run(fed()):
        match message:
            case NavigationSolution():
                builder.add(message)
            case TrustState() | NavigationState():
                log.add(message)
            case GnssFix() if message.latitude_deg is not None:
                fixes.append(message)
    verdicts = log.verdicts(arrivals[0], arrivals[-1]) if with_trust else None
    return DriveRun(builder.track().valid(), log, verdicts, fixes)


def assert_harmless(
    vehicle: VehicleFile, messages: Messages, truth: Callable[[list[GnssFix]], Reference], *, independent: bool = True
) -> None:
    """Hold a healthy drive to the bounds, that of errors above the level where the truth is independent."""
    arm = vehicle.facts.gnss.lever_arm_body_m
    run = solved(vehicle, messages)
    plain = solved(vehicle, messages, with_trust=False) if run.log.excluded else run
    reference = truth(plain.fixes)
    assert run.verdicts is not None and len(run.track) and len(plain.track)
    longest_s = max(((end - begin) / SECOND_NS for begin, end in run.verdicts.exclusions()), default=0.0)
    harm = harm_of(reference, run.track, plain.track, lever_arm_b=arm)
    settled = errors_against(reference, run.track, lever_arm_b=arm).since(int(run.verdicts.edges_ns[0]) + SETTLED_NS)
    limits = vehicle.facts.alert_limits_m
    above = [float((item.error_m > item.level_m).mean()) for item in protected(settled, limits)[:1]]
    assert isinstance(harm, Harm), "the truth covers the drive"
    broken = [
        sentence
        for holds, sentence in (
            (longest_s <= LONGEST_EXCLUSION_S, f"GNSS was excluded for {longest_s:.1f} s at once"),
            (
                harm.with_trust_m <= max(HARM * harm.without_trust_m, harm.without_trust_m + HARM_M),
                f"error with core.trust {harm.with_trust_m:.3f} m, without it {harm.without_trust_m:.3f} m",
            ),
            (
                not (independent and above) or above[0] <= ABOVE_LEVEL,
                f"{above} of the errors above the level after 60 s",
            ),
        )
        if not holds
    ]
    assert not broken, "; ".join(broken)


def first_seconds(inputs: Inputs, vehicle: VehicleFile, seconds: float) -> Messages:
    """The messages of the first seconds of a recording."""
    last_ns = arrival_of(inputs.envelopes[0]) + round(seconds * SECOND_NS)
    cut = Inputs(list(takewhile(lambda envelope: arrival_of(envelope) <= last_ns, inputs.envelopes)))
    return partial(cut.messages, vehicle)


@pytest.mark.slow
@pytest.mark.recording
@pytest.mark.parametrize(
    ("mapping", "folder", "seconds", "truth_by_fixes"),
    [
        ("comma_segment", "comma_segment", 60.0, False),
        ("wid_car", "wid_car/trial02", 100.0, True),
        ("rtkexp_drive", "rtkexp_drive", 120.0, True),
        ("navmatlab_car_0327", "navmatlab_car_0327", 120.0, False),
    ],
)
def test_a_healthy_receiver_is_not_taken_away(
    mapping: str, folder: str, seconds: float, truth_by_fixes: bool, tmp_path: Path
) -> None:
    source = recording(folder)
    path = tmp_path / "drive.mcap"
    import_drive(REPOSITORY / "benchmarks" / "recordings" / "mappings" / f"{mapping}.toml", source, path)
    with Recording(path) as opened:
        inputs = inputs_of(opened)
        at_antenna = opened.metadata.get("provenance", {}).get("truth_at") == "antenna"
        vehicle = vehicle_of(opened, None)
    gnss = vehicle.section("core.fusion", Config).gnss

    def truth(fixes: list[GnssFix]) -> Reference:
        if truth_by_fixes:
            return from_fixes(fixes, delay_s=gnss.delay_s, velocity_delay_s=gnss.velocity_delay_s)
        return from_states(inputs.truth, at_antenna=at_antenna)

    assert_harmless(vehicle, first_seconds(inputs, vehicle, seconds), truth, independent=not truth_by_fixes)


GYROSCOPE_SCALE = 0.02  # [-] of all axes
FORCE_SD, RATE_SD = 0.1, 0.005  # [m/s², rad/s] white noise of each sample at 100 Hz, in addition to the simulated one
DURATION_S = 100.0


def with_a_low_cost_imu(drive: Drive) -> Drive:
    """The same drive with the noise of an IMU for toys, and gyroscopes that measure 2 % too much."""
    rng = np.random.default_rng((drive.seed, 98))
    return replace(
        drive,
        force_b=drive.force_b + FORCE_SD * rng.standard_normal(drive.force_b.shape),
        rate_b=(1.0 + GYROSCOPE_SCALE) * drive.rate_b + RATE_SD * rng.standard_normal(drive.rate_b.shape),
    )


def true_path(drive: Drive) -> Reference:
    tenth = slice(None, None, 10)
    return Reference(
        "simulated", drive.t_ns[tenth], at_antenna=False, geodetic=drive.position[tenth],
        velocity_n=drive.velocity_n[tenth], attitude=drive.attitude[tenth],
    )  # fmt: skip


def test_a_healthy_receiver_beside_a_low_cost_imu_without_odometer_is_not_taken_away() -> None:
    drive = with_a_low_cost_imu(simulate("urban", seed=1, duration_s=DURATION_S))
    vehicle = parse_vehicle(f"[vehicle.gnss]\nlever_arm_body_m = {list(drive.lever_arm_b)}\n", "low-cost.toml")

    def messages() -> Iterator[Message]:  # the unit makes ticks of its own
        return (made for made in typed_messages(drive, odometer=False) if not isinstance(made, Tick))

    assert_harmless(vehicle, messages, lambda _: true_path(drive))

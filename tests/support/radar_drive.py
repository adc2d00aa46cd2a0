"""Drives a simulated car with the radar of `tests/support/radar` as its only speed: run as a program with that folder
on PYTHONPATH. Prints what the filter has found, as JSON; the radar reads too much by the first argument."""

import json
import sys
from math import sqrt

import numpy as np

from benchmarks.given import fixes_of
from cli.papers.navigation import YAW_SD, saved_heading
from services.core.fusion.aids.kinds import measurements_of
from services.core.fusion.aids.odometer.settings import OdometerSettings
from services.core.fusion.batch import solve
from services.core.fusion.navigator import Navigator
from services.core.fusion.settings import Settings
from services.core.fusion.start.warm_start import fingerprint
from services.core.fusion.states import LAYOUT
from services.sensors.simulator.drive import simulate
from shared.messages.vehicle import VehicleSpeed
from shared.runtime.config import GnssAntenna, Vehicle


def main(scale: float) -> None:
    """Drive for a minute and a half."""
    drive = simulate("parking_lot", 1, 90.0)
    settings = Settings(
        vehicle=Vehicle(gnss=GnssAntenna(lever_arm_body_m=drive.lever_arm_b)), odometer=OdometerSettings(enabled=False)
    )
    navigator = Navigator(settings)
    navigator.use_prior(saved_heading(drive, YAW_SD))
    speeds = [
        VehicleSpeed(sampled_ns=time_ns, received_ns=time_ns, source="radar0", speed_m_s=(1.0 + scale) * speed)
        for time_ns, speed in zip(drive.odometer_ns.tolist(), drive.odometer.tolist(), strict=True)
    ]
    measured = [*fixes_of(drive, settings), *(one for speed in speeds for one in measurements_of(speed, settings))]
    found = list(solve(navigator, drive.t_ns, np.hstack([drive.force_b, drive.rate_b]), measured, every_ns=10**9))
    result = {"size": LAYOUT.size, "fingerprint": fingerprint(settings), "solutions": len(found)}
    if "radar_scale" in {block.name for block in LAYOUT.blocks}:
        place, navigation = LAYOUT.index("radar_scale"), navigator.engine.filter
        assert navigation is not None
        result |= {"scale": navigation.parameter(place), "sd": sqrt(float(navigation.P[place, place]))}
    sys.stdout.write(json.dumps(result))


if __name__ == "__main__":
    main(float(sys.argv[1]))

"""Drives a simulated car with the displacement by carrier phases switched off, and prints a hash of every bit of it.

With the argument `without`, the folder of that aid brings no states at all: the filter as it was before there was one.
"""

import json
import sys
from hashlib import sha256

import numpy as np

from services.core.fusion import blocks
from services.core.fusion.aids.carrier import states as carrier

SECONDS = 60.0


def leave_out() -> None:
    """Take the states away before any module reads the layout; what would stand in them has no place."""
    carrier.BLOCKS = ()  # type: ignore[assignment]
    place = blocks.Layout.place

    def placed(layout: blocks.Layout, name: str) -> "slice[int, int, None]":
        return slice(0, 0) if name.startswith("carrier_") else place(layout, name)

    blocks.Layout.place = placed  # type: ignore[method-assign, assignment]


def main() -> None:
    """Drive, and hash every solution and covariance on the way."""
    if sys.argv[1:] == ["without"]:
        leave_out()
    from benchmarks.given import fixes_of  # these read the layout
    from cli.papers.navigation import YAW_SD, saved_heading
    from services.core.fusion.batch import solve
    from services.core.fusion.navigator import Navigator
    from services.core.fusion.settings import Settings
    from services.core.fusion.states import LAYOUT
    from services.sensors.simulator.drive import simulate
    from shared.runtime.config import GnssAntenna, Vehicle

    drive = simulate("parking_lot", 1, SECONDS)
    settings = Settings(vehicle=Vehicle(gnss=GnssAntenna(lever_arm_body_m=drive.lever_arm_b)))
    navigator, found = Navigator(settings), sha256()
    navigator.use_prior(saved_heading(drive, YAW_SD))
    samples = np.hstack([drive.force_b, drive.rate_b])
    solutions = 0
    for solution in solve(navigator, drive.t_ns, samples, fixes_of(drive, settings), every_ns=10**8):
        navigation = navigator.engine.filter
        assert navigation is not None
        found.update(repr(solution).encode() + navigation.P.tobytes() + repr(navigation.parameters).encode())
        solutions += 1
    result = {"layout": LAYOUT.size, "states": navigator.engine.filter.size, "solutions": solutions}  # type: ignore[union-attr]
    sys.stdout.write(json.dumps(result | {"hash": found.hexdigest()}))


if __name__ == "__main__":
    main()

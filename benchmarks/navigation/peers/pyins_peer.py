"""pyins: inertial navigation in Python, Nikolay Mayorov (MIT).

This file is not named as that library, which the script beside it imports.
"""

from pathlib import Path

import numpy as np

from shared.maths.earth import FloatArray

from .common import START_S, Peer, PeerInput, thinned

HOW = "`python -m benchmarks.navigation.peers.build` installs it, or set OBU_PYINS to the bin/python that has it."


class Pyins(Peer):
    """It is a library: a script of ours is run by the Python that has it. A run takes minutes: no outages."""

    name, variable, how, outages = "pyins", "OBU_PYINS", HOW, False
    sets, built = ("rtk",), "pyins/bin/python"

    def prepare(self, data: PeerInput, folder: Path, program: str) -> list[str]:
        """Write arrays."""
        after = data.imu[data.imu[:, 0] > START_S]
        gnss = data.gnss[data.gnss[:, 0] > START_S]
        np.savez(folder / "given.npz", imu=after, gnss=gnss, initial=data.initial, start=START_S)
        return [program, str(Path(__file__).with_name("pyins_filter.py")), str(folder)]

    def result(self, folder: Path) -> FloatArray:
        """Rows as they are judged."""
        return thinned(np.load(folder / "result.npy"))

"""States of the displacement by carrier phases: the offset of the integrated path, and its drift.

The offset takes the place of a cloned position: at an anchor it is the error of the antenna's position and the noise of
that epoch's phases, and later displacements measure the position against it.
"""

from ...blocks import Block
from ...settings import Settings


def _on(settings: Settings) -> bool:
    return settings.carrier.enabled


BLOCKS = (
    Block("carrier_offset", 3, "m, NED", on=_on),  # an anchor sets it
    Block("carrier_drift", 3, "m/s, NED", on=_on),  # and this, a Gauss-Markov process
)

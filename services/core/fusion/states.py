"""The states of the filter, assembled of blocks when this module is imported.

The first blocks are those of inertial navigation. Behind them stands what the aids estimate beside it: a scale, an
offset, a correlated error. An aid finds its own by name, and no place is a number anywhere else. Those that stand last
are left out of a filter whose settings do not switch their aid on.

A package that is installed beside the unit may bring further blocks (`aids/kinds.py`): an entry point of the group
`obu.aid_states` is a module with a tuple `BLOCKS`.
"""

from typing import Any, cast

from shared.packages import AID_STATES, brought

from .aids.barometer.states import BLOCKS as BAROMETER
from .aids.carrier.states import BLOCKS as CARRIER
from .aids.gnss.states import POSITION_BLOCKS, VELOCITY_BLOCKS
from .aids.non_holonomic.states import BLOCKS as NON_HOLONOMIC
from .aids.odometer.states import BLOCKS as ODOMETER
from .blocks import Block, Layout

INERTIAL = (
    Block("attitude", 3, "rad, NED", psd=lambda s: s.imu.angle_random_walk_rad_sqrt_s**2),
    Block("velocity", 3, "m/s, NED", psd=lambda s: s.imu.velocity_random_walk_m_s_sqrt_s**2),
    Block("position", 3, "m, NED"),
    Block("accelerometer_bias", 3, "m/s², body", psd=lambda s: s.imu.accelerometer_bias_psd_m2_s5),
    Block("gyroscope_bias", 3, "rad/s, body", psd=lambda s: s.imu.gyroscope_bias_psd_rad2_s3),
    Block("accelerometer_scale", 3, "-", sd=lambda s: s.imu.accelerometer_scale_sd),
    Block("gyroscope_scale", 3, "-", sd=lambda s: s.imu.gyroscope_scale_sd),
)
AIDS = (*ODOMETER, *NON_HOLONOMIC, *POSITION_BLOCKS, *BAROMETER, *VELOCITY_BLOCKS)
LEFT_OUT_WHEN_OFF = (*CARRIER,)  # behind all others: see `Layout.blocks_by`


def external_blocks() -> tuple[Block, ...]:
    """Blocks of installed packages, in the order of the names of their entry points."""
    return tuple(block for module in brought(AID_STATES) for block in cast(Any, module).BLOCKS)


LAYOUT = Layout((*INERTIAL, *AIDS, *external_blocks(), *LEFT_OUT_WHEN_OFF))

"""States of the constraint: pitch and yaw of the IMU in the vehicle."""

from ...blocks import Block

MOUNTING_PSD = 1e-9  # [rad²/s] 0.1 degrees in an hour

BLOCKS = (Block("mounting", 2, "rad", sd=lambda s: s.non_holonomic.mounting_sd_rad, psd=lambda _: MOUNTING_PSD),)

"""States of the odometer: the error of its scale."""

from ...blocks import Block

SCALE_PSD = 1e-8  # [1/s] 0.6 % in an hour

BLOCKS = (Block("odometer_scale", 1, "-", sd=lambda s: s.odometer.scale_sd, psd=lambda _: SCALE_PSD),)

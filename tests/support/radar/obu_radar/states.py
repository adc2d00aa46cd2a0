"""The state of the radar: the error of its scale, by the angle at which it looks."""

from services.core.fusion.blocks import Block

BLOCKS = (Block("radar_scale", 1, "-", sd=lambda _: 0.05, psd=lambda _: 1e-9),)

"""States of the receiver: time-correlated errors of its positions and velocities, Gauss-Markov processes."""

from ...blocks import Block

POSITION_BLOCKS = (Block("gnss_error", 3, "- of its standard deviation"),)  # the first fix sets it
VELOCITY_BLOCKS = (Block("gnss_velocity_error", 3, "m/s, NED"),)

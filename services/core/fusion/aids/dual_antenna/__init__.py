"""Aid: heading of the line between two antennas."""

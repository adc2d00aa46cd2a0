"""Start of the filter: roll and pitch, heading and position before the filter runs, or a saved state."""

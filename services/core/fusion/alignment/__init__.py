"""Initial alignment: roll and pitch, heading and position before the filter runs."""

"""GNSS against inertial sensors: windows of 5 s, and of 30 and 60 s."""

"""The tests: GNSS against the inertial sensors over 5 s, and over 30 and 60 s of free propagation."""

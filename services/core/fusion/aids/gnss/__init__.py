"""GNSS as an aid: positions and velocities, models of their errors, comparison with the inertial sensors."""

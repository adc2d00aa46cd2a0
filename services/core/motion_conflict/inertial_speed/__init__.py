"""Common scale of GNSS and odometer speed against the speed of inertial sensors in bends."""

"""Tilt, yaw and gyroscope bias that GNSS never touches: of inertial samples and standing wheels alone."""

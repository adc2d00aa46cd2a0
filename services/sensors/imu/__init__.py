"""Layer 1, IMU: the inertial measurement unit."""

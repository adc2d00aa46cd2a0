"""Layer 2, IMU: Xbus bytes to inertial samples in body axes."""

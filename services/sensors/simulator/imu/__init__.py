"""The simulated inertial measurement unit: ideal readings, errors, and the bytes it sends."""

"""The simulated inertial measurement unit: ideal measurements, errors and output bytes."""

"""Lines of a phone: fixes, raw measurements, navigation words and inertial sensors."""

"""GNSS speed against odometer speed: the tachograph's tests, odometer calibration and a fast chi-square test."""

"""Yaw rate of the gyroscope against wheels, GNSS course, second antenna and magnetometer."""

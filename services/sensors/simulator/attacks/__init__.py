"""Attacks on the simulated vehicle: what they make of the signals at its antenna and of its odometer."""

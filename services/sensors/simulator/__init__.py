"""Drives a simulated vehicle and sends the bytes its devices would."""

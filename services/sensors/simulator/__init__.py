"""Simulates a vehicle and publishes the raw bytes of its devices."""

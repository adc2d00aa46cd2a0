"""Vehicles at a toll plaza: their tracks, their lanes, their passages."""

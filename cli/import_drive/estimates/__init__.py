"""Estimates of axes, delays and clock offsets from the data."""

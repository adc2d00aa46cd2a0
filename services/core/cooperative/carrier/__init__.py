"""Displacement of the antenna from carrier phases."""

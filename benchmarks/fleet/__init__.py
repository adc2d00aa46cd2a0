"""Whole fleets against a centre of this machine."""

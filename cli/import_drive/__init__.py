"""Converts files of a drive to typed messages as defined by a mapping."""

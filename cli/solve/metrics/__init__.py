"""Errors and metrics of a solved drive."""

"""Readers of the formats: CSV rows, arrays, GnssLogger logs."""

"""Simulates many vehicles that report to a centre on this machine, and holds what it stored against what was made."""

"""The true motion of the simulated vehicle."""

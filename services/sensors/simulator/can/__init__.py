"""The simulated CAN bus."""

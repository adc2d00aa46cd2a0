"""The simulated GNSS receiver: satellites, errors and output bytes."""

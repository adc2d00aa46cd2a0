"""The simulated GNSS receiver: satellites, errors, and the bytes it sends."""

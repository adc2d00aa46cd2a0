"""Layer 1, GNSS: the receiver."""

"""Layer 1, power: an uninterruptible power supply, or a signal of the mains."""

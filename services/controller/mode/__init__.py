"""Layer 3, mode: what the on-board unit should be doing now."""

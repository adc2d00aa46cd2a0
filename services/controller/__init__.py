"""Layer 3: what the unit should be doing now."""

"""Layer 4: where we are, and how far to trust it."""

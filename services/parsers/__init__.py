"""Layer 2: decodes bytes to typed messages in SI units, and encodes commands."""

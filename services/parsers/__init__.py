"""Layer 2: bytes to typed messages in SI units, and back."""

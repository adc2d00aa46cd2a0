"""Layer 2, power: readings of a supply in SI units, and whether its battery is nearly empty."""

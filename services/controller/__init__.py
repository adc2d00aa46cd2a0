"""Layer 3: operating mode and configuration of the unit."""

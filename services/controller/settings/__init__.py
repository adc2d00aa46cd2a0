"""Layer 3, settings: changes those of the unit, watches what follows, and takes a change back that harms it."""

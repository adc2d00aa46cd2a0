"""Plausibility limits: inputs that no road vehicle or sensor can produce are counted and rejected."""

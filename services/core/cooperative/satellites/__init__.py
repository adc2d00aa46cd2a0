"""Plain RAIM: measurement model, weighted least squares, fault detection and exclusion."""

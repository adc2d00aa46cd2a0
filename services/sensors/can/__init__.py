"""Layer 1, CAN: the vehicle network."""

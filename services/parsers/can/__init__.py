"""Layer 2, CAN: candump lines to vehicle and wheel speeds."""

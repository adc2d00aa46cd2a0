"""Layer 1: device drivers, which publish stamped raw bytes."""

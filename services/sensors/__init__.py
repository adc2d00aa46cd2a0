"""Layer 1: devices to raw bytes, stamped."""

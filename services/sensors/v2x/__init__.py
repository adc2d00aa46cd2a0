"""Layer 1, V2X: frames from and to the radio."""

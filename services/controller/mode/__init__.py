"""Layer 3, mode: operating mode, configuration of receivers, last position."""

"""Layer 1, corrections: sources of GNSS corrections, over networks and serial ports."""

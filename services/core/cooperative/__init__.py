"""Layer 3: satellite fault detection and exclusion from raw pseudoranges, alone and with V2X neighbours."""

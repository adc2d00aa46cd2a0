"""Layer 2, corrections: frames of RTCM 3, SPARTN and UBX, and the choice of a source."""

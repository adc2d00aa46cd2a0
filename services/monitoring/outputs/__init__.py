"""Layer 5, outputs: the position for other programs, as gpsd and NMEA 0183 give it."""

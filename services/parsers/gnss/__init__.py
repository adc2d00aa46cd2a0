"""Layer 2, GNSS: UBX and NMEA bytes to fixes, and commands to UBX."""

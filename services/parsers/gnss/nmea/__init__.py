"""NMEA 0183: framing, and sentences to fixes and satellites."""

"""Out-of-sequence measurements, clocks and delays."""

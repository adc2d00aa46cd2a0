"""The receiver's own evidence of jamming and spoofing: its flags, signal levels, gain and clock."""

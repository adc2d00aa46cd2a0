"""Mathematics that more than one process needs: no bus, no clock, no files."""

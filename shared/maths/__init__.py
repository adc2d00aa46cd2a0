"""Mathematics shared by several processes, without bus, clock and files."""

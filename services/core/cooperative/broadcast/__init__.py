"""Broadcast navigation data: decoding, keeping, and satellite position, velocity and clock from it."""

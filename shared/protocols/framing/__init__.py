"""Finds the frames of protocols in byte streams."""

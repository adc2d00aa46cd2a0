"""Filters that track vehicles from CAM: motion models, and filters of one or two of them."""

"""Aid: magnetic heading."""

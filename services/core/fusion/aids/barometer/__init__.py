"""Aid: barometric height, with its offset as a state."""

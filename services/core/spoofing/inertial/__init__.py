"""What the tests compare: increments and their propagation, odometer and heights, the attitude of a phone."""

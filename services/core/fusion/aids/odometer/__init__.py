"""Aid: speeds of the wheels, with the scale of the odometer as a state."""

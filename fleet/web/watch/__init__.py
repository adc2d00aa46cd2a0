"""Sessions in which operators watch a vehicle, and the page of the unit that they see."""

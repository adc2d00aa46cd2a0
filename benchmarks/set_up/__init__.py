"""Wrong installations, in the simulator and in recordings: what one or two drives find of them."""

"""Solutions that leave sensors out, all the time: where the vehicle is if these are wrong."""

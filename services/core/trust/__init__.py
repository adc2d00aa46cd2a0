"""One verdict on the position, from the monitors' statements and fusion's protection levels."""

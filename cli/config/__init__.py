"""`obu config`: settings of a vehicle's file, by their names."""

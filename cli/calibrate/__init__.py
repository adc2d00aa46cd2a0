"""`obu calibrate`: learns settings of the unit from recorded drives."""

"""Slow drifts of GNSS, by sums of the navigation filter's innovations over minutes."""

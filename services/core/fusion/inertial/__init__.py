"""Strapdown mechanisation, error model and filter: what the inertial sensors alone say, and its covariance."""

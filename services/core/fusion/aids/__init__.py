"""Aids: each gives innovation, Jacobian and noise covariance of one kind of measurement."""

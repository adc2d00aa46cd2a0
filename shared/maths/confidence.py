"""Factors from standard deviations to confidences of 95 %, as CAM and receivers state them."""

SCALAR_95 = 1.959964  # standard normal distribution, two-sided
ELLIPSE_95 = 2.447747  # sqrt of the 0.95 quantile of chi-square with 2 degrees of freedom: sqrt(-2 ln 0.05)

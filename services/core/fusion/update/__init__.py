"""The estimator: which measurements are used, with what weight, and what happens between them."""

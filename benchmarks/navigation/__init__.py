"""Accuracy on real and simulated drives beside its goals and peers, and the cost of an inertial sample."""

"""Loosely coupled INS/GNSS: where the vehicle is, and how well that is known."""

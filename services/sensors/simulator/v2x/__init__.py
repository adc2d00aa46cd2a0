"""Neighbouring vehicles, and the V2X radio that receives them."""

"""Charges: exactly one for a passage, with its evidence, and the account of every detection."""

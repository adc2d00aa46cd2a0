"""Verifies what vehicles report, stores it once, and sends receipts after the commit. Any number may run at once."""

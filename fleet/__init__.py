"""The control centre: receives what units report, stores it once, and shows a fleet."""

"""The state of the unit for people and programs: dashboard, JSON, metrics."""

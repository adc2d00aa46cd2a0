"""The state of the unit as the dashboard, the API and Prometheus show it."""

"""What comes of attacks and failures on a running unit: `make security`."""

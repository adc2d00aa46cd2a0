"""Protection levels against true errors: simulated drives by the hundred, and recordings with truth."""

"""A speed over ground by radar, as a package beside the unit: nothing of it is known to core.fusion."""

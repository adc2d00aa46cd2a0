"""V2X-assisted integrity: forward estimate from neighbours and the map, and the tests that use it."""

"""The timeline: samples, measurements and events in the order of their stamps, and cursors on it."""

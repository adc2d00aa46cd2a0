"""The messages of the bus: one type a topic, SI units in the names, `None` for what is missing."""

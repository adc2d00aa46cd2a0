"""The runtimes of a process: live from the bus, and offline from a recording."""

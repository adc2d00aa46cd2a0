"""The mapping of a drive: schema, units, parsing."""

"""Commands on recordings: record, repair, replay, verify."""

"""Every setting of a unit by its name; changes of its file, with their history."""

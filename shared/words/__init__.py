"""The words of codes: rows of data beside their owners, further languages, and their rendering."""

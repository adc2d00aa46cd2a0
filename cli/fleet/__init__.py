"""`obu fleet`: many recordings, and many vehicles, by one command."""

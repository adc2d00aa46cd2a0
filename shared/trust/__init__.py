"""What all integrity monitors share: the result of a test, since when it lasts, and how it is published."""

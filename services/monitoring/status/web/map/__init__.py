"""Routes of the page Map, and its tiles."""

"""The installed map and its tiles."""

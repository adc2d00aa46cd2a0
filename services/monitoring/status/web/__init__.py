"""HTTP and WebSocket server of the status process."""

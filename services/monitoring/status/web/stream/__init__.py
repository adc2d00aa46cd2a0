"""Frames to those who stay connected: WebSocket and server-sent events."""

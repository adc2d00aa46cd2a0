"""Writes every message to disk."""

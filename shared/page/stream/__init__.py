"""Connections that stay open: one encoded frame for every client."""

"""Conversion of columns to messages."""

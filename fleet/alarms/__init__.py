"""Raises and ends alarms by what is stored, and tells web hooks."""

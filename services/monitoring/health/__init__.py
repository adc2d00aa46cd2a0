"""Holds every topic and process against its deadline."""

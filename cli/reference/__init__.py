"""Prints what the repository holds of its code: reference pages, the picture of the architecture, units of systemd."""

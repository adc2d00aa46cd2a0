"""Inertial navigation shared by several processes, without aids, bus, clock and files."""

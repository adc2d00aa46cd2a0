"""The only thing that processes have in common: topics, messages, the bus and the runtimes."""

from datetime import date

VERSION = "0.1.0"  # of the project
RELEASED = date(2026, 11, 25)  # of this version: set with it

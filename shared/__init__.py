"""The only thing that processes have in common: topics, messages, the bus and the runtimes."""

VERSION = "0.1.0"  # of the project

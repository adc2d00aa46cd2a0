"""The only thing that processes have in common: topics, messages, the bus and the runtimes."""

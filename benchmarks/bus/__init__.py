"""The bus beside the same thing in C: one hop, three hops, and what the whole unit costs."""

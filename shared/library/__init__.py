"""The recordings of a unit as a list, without what reads MCAP: for processes that only show them."""

"""`obu papers toll`: the filters of the C-ITS toll paper, and lane decisions with and without delta position."""

"""`obu papers`: reproduces published results."""

"""`obu papers`: published results reproduced."""

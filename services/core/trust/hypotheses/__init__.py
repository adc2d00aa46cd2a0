"""What may be wrong, how probable it is, and what follows."""

"""Small faults put into the code on purpose, and whether its tests find them."""

"""What the whole unit costs on its bus, and how long an inertial sample takes from the driver to the solution."""

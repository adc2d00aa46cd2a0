"""The on-board unit: five layers of processes, and the commands that start them."""

"""Who may connect, and what a request carries."""

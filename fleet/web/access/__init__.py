"""Who may look and act: accounts, sessions, roles, and the guard before every route."""

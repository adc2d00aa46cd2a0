"""Who may look and act: tokens, sessions, rights of routes."""

"""Starts a real PostgreSQL and a real nats-server for a centre on one machine, and for tests."""

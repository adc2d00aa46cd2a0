"""The brokers: Mosquitto's configuration, and a small broker for demo and tests."""

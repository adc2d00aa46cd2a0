"""MQTT 5 for both ends of a connection: one codec, used by our client and by the simulated broker."""

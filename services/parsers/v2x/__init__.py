"""Layer 2, V2X: frames to and from Cooperative Awareness Messages."""

"""Layer 3, CAM: when this vehicle sends its own Cooperative Awareness Message, and what it states."""

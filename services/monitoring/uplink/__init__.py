"""Layer 5, uplink: reports position, verdict and events to a control centre, each once."""

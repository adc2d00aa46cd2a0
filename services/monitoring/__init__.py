"""Layer 5: watches, stores, shows and forwards."""

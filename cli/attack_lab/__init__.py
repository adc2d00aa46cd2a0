"""`obu attack-lab`: attacks on simulated and recorded drives, and how the monitors and the verdict answer."""

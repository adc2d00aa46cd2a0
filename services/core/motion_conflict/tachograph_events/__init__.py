"""Events of the smart tachograph: what begins and ends them, and which records are kept."""

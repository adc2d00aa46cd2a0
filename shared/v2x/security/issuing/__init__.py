"""How a PKI and its stations issue and sign: of simulated traffic, and of tests. Nothing that verifies needs it."""

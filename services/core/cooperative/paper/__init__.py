"""The published scenario of DSRC-assisted integrity monitoring, and its Monte Carlo simulation."""

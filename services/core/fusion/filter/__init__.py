"""The error-state Kalman filter: strapdown mechanisation, error model, propagation and correction."""

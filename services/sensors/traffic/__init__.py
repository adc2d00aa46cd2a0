"""A simulated toll plaza: vehicles with their GNSS errors and CAM, detectors, and the operator."""

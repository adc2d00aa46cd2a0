"""The detectors and cameras of a toll plaza."""

"""The survey of an installation: mounting, lever arm, delay and scale of a whole drive at once, by least squares."""

"""The geoid: mean sea level above the ellipsoid."""

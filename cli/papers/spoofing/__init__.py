"""`obu papers spoofing`: GNSS spoofing detection by the sensors of a phone."""

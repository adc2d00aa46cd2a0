"""`obu demo` and `obu up`: every process on this machine."""

"""What holds for every test: hypothesis draws the same examples each time, and never for a time limit."""

from hypothesis import settings

settings.register_profile("obu", derandomize=True, deadline=None)
settings.load_profile("obu")

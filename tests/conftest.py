"""Settings of all tests."""

from hypothesis import settings

# The same examples at every run, and no limit on an example's time: a busy machine is no failure.
settings.register_profile("repeatable", derandomize=True, deadline=None)
settings.load_profile("repeatable")

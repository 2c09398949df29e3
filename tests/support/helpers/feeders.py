"""The named feeders by their kind."""

from dcgrid_env import FEEDERS

THREE_PHASE = tuple(name for name in FEEDERS if name.endswith("-3ph"))
BALANCED = tuple(name for name in FEEDERS if name not in THREE_PHASE)

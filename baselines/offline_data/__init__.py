"""Episodes of a behaviour as a data set for offline reinforcement learning, in Minari's format."""

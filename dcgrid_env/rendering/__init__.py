"""Pictures: the feeder on its map, the curves of an episode, the figure of a run."""

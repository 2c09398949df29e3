"""Bus and branch figures of the named feeders, with their sources."""

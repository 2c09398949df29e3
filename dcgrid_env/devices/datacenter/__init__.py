"""The data centre: its queue of work, and the clock laws that serve it."""

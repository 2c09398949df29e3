"""A step of the grid and its devices, from a state and an action."""

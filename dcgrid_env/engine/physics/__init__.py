"""How a step of the grid and its devices is computed from a state and an action."""

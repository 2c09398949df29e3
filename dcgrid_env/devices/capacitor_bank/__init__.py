"""Banks of capacitors that are switched by their own control, or by an agent's command."""

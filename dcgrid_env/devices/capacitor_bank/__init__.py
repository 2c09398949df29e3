"""Banks of capacitors that are switched: by a control of their own, or at an agent's command."""

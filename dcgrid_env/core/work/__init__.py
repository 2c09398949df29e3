"""Units of work and the places where they run: processes of this machine, or the nodes of a Ray cluster."""

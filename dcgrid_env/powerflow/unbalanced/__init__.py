"""Power flow of unbalanced three-phase radial feeders: a backward and forward sweep in generalised matrices."""

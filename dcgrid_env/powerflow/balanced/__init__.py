"""Power flow of balanced radial feeders: one file per method, with separate files for its other forms."""

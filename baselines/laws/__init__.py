"""Control laws, one a file, and how large the gains of the linear ones may be."""

"""File formats of feeders, one a file."""

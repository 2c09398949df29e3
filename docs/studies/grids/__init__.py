"""Grids of other programs and random feeders."""

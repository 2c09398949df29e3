"""Radial feeders drawn at random with the statistics of published ones, one by one and in families."""

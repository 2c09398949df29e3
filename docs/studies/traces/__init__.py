"""Comparisons of the trace generators with recordings."""

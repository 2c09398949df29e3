"""Learned policies and their training. Empty so far: training arrives with the first algorithm."""

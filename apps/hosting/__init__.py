"""Hosting capacity: the largest data centre that a feeder carries at each of its buses, under each controller."""

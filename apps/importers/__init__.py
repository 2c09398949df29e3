"""Feeders in files of other programs: readers, writers, and the commands ``dcgrid import`` and ``dcgrid export``."""

"""Tools without a link to grids: units, arrays, random numbers, threads, processes, files, locks and caches.

A *row* is the place of one environment in the arrays of a batch: rows come first, (row, ...).
Each row has its own episode.
Publicly the size of a batch is ``num_envs``.
"""

"""Tools without a link to grids: units, arrays, random numbers, threads, processes, files, locks and caches.

A *lane* is one member of a batch: arrays over a batch have lanes first, (row, ...), each with an episode of its own.
Publicly the size of a batch is ``num_envs``.
"""

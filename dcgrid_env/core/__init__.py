"""Tools that know nothing of grids: units, arrays, random numbers, threads, processes, files, locks and caches."""

"""Coordinates of a random feeder: chains run straight, and leave what feeds them to the side that has fewer."""

from __future__ import annotations

import numpy as np

from dcgrid_env.grid.random_feeders.tree import Tree

_HEADINGS = 16
_HALF_TURN = np.array([1.0, 0.923880, 0.707107, 0.382683, 0.0, -0.382683, -0.707107, -0.923880])
_COSINES = np.concatenate((_HALF_TURN, -_HALF_TURN))
_SIDE = 4  # a right angle


def positions_km(tree: Tree, length_km: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Coordinates of the buses, km from the substation, (n_bus,) each, to the metre.

    Branches have their lengths; they may cross, as the tree knows no map.
    """
    n = len(tree.parent) + 1
    x, y, heading = np.zeros(n), np.zeros(n), np.zeros(n, np.intp)
    departures = max(1, int((tree.parent == 0).sum()))
    of_chain: dict[int, int] = {}
    for k, (fed_by, chain) in enumerate(zip(tree.parent.tolist(), tree.chain.tolist(), strict=True)):
        if chain not in of_chain:
            if fed_by == 0:
                of_chain[chain] = chain * max(1, _HEADINGS // departures) % _HEADINGS
            else:
                of_chain[chain] = (int(heading[fed_by]) + (_SIDE if len(of_chain) % 2 else -_SIDE)) % _HEADINGS
        heading[k + 1] = of_chain[chain]
        x[k + 1] = x[fed_by] + length_km[k] * _COSINES[heading[k + 1]]
        y[k + 1] = y[fed_by] + length_km[k] * _COSINES[(heading[k + 1] - _SIDE) % _HEADINGS]
    return np.round(x, 3), np.round(y, 3)

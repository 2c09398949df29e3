"""The ends of a feeder, the farthest first and spread over its branches."""

from __future__ import annotations

import numpy as np

from dcgrid_env.grid import AnyFeeder, Feeder


def feeder_ends(feeder: AnyFeeder, allowed: np.ndarray) -> list[int]:
    """Return the positions in ``bus_ids`` of the feeder's ends, starting with those that are farthest apart.

    An end is an allowed bus without an allowed bus behind it. The first end is the electrically farthest from the
    source. Each next end has the most impedance between itself and the paths to the previous ends. The first few ends
    are therefore on different branches rather than side by side at the tip of the longest. This is the long-path
    decomposition of the tree, computed in one pass.

    Parameters
    ----------
    feeder
        Any feeder.
    allowed
        Whether a bus may be chosen, bool, (n_bus,).
    """
    z_pu = branch_impedance(feeder)
    order = feeder.depth_first.order
    length = np.zeros(feeder.n_bus)
    tip = np.full(feeder.n_bus, -1)
    chains: list[tuple[float, int]] = []
    for i in order[::-1].tolist():
        if tip[i] < 0 and allowed[i]:
            tip[i] = i
        if i == 0 or tip[i] < 0:
            continue
        parent = int(feeder.parent[i - 1])
        reach = float(length[i] + z_pu[i - 1])
        if tip[parent] < 0 or reach > length[parent]:
            if tip[parent] >= 0:
                chains.append((length[parent], int(tip[parent])))
            length[parent], tip[parent] = reach, tip[i]
        else:
            chains.append((reach, int(tip[i])))
    if tip[0] > 0:
        chains.append((float(length[0]), int(tip[0])))
    return [end for _, end in sorted(chains, key=lambda chain: (-chain[0], chain[1]))]


def branch_impedance(feeder: AnyFeeder) -> np.ndarray:
    """Magnitude of the series impedance of the branch to each bus but the first, p.u., (n_branch,)."""
    return np.hypot(feeder.r_pu, feeder.x_pu) if isinstance(feeder, Feeder) else feeder.branch_z_pu

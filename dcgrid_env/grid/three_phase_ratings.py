"""Rated currents of the branches of a three-phase feeder, by the nodes that they feed.

A line or switch has an ampacity. A transformer carries its rating at the rated voltage of its to-side. The line
currents there are those of the windings behind it, apart from the turns ratio. A regulator carries its own rating at
its rated voltage.
"""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from dcgrid_env.grid.network import Network
from dcgrid_env.grid.three_phase_tables import FALLBACKS, RATINGS
from dcgrid_env.grid.three_phase_tree import Branch, Tree


def ratings_a(network: Network, tree: Tree) -> NDArray[np.float64]:
    """Rated current of what feeds each node, A, shape (n_node,); NaN where it is not known, and at the source."""
    rated = [math.nan] * len(tree.phases[0])
    for branch, phases in zip(tree.branches, tree.phases[1:], strict=True):
        of_phase = dict(_of_phases(network, branch))
        rated += [of_phase[phase] for phase in phases]
    return np.array(rated)


def _of_phases(network: Network, branch: Branch) -> Iterator[tuple[str, float]]:
    table, column = getattr(network, branch.kind), RATINGS[branch.kind]
    ratings = getattr(table, column) or getattr(table, FALLBACKS[column] or "", ())
    for row in branch.rows:
        amps = ratings[row] if ratings else math.nan
        if branch.kind == "transformer":
            amps /= len(branch.phases) * table.kv_ll_to[row] / math.sqrt(3.0)
        elif branch.kind == "regulator":
            amps /= table.kv_ln[row]
        for phase in table.phases[row]:
            yield phase, amps

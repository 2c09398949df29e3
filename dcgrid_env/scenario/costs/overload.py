"""Overload of branches: the excess of currents over ratings, for feeders with rated branches.

    overload = mean over rated branches of min(max(loading - 1, 0), 9)      loading: current as a share of the rating

On a three-phase feeder each phase of a line counts as a branch. The excess is limited to 9 ratings to give the term an
upper bound; feeders do not operate beyond it in practice. The term is a constraint in ``info["cost"]`` if it has a
weight.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from dcgrid_env.core.arrays import Array, positive_part, sum_last, take_at
from dcgrid_env.core.metric import Metric
from dcgrid_env.powerflow import rated_nodes

MOST_EXCESS = 9.0
"""Largest overload of a branch that is charged, as a share of its rating."""


METRICS = (
    Metric("loading_max_pct", "highest loading of a branch", "% of its rating", 1, "lower",
        "largest current of a branch, as a share of its rating", "max", over_episodes="max"),
    Metric("overloaded_branch_seconds_pct", "branch-seconds above the rating", "%", 2, "lower",
        "share of rated branches (phases of a line) and steps above the rating", "mean"),
)  # fmt: skip
"""Metrics of loadings, on feeders that know ratings."""


def mean_overload(scenario: Any, loading: Array) -> Array:
    """Mean overload over the rated branches, (row,), of their loading, as in ``State.loading``."""
    over = positive_part(loading - 1.0)
    return sum_last(MOST_EXCESS - positive_part(MOST_EXCESS - over)) / len(rated_nodes(scenario.feeder))


def loading_of_agents(state: Any, nodes: Array) -> Array:
    """Loading of the branch that feeds each agent's bus, of its most loaded phase, (row, n_agent).

    Of a bus in a loop it is that of the branch in the feeder's tree.
    """
    loading = take_at(state.loading[..., : state.v_pu.shape[-1]], nodes)
    if loading.shape[-1] == 1:
        return loading[..., 0]
    return loading.max(-1) if isinstance(loading, np.ndarray) else loading.amax(-1)


def overload_figures(scenario: Any, loading: Array) -> dict[str, float]:
    """Metrics of ``State.loading`` over the steps 1 .. T, with time first; none where it is None."""
    if loading is None:
        return {}
    rated = loading[1:, rated_nodes(scenario.feeder)]
    return {
        "loading_max_pct": 100.0 * float(rated.max()),
        "overloaded_branch_seconds_pct": 100.0 * float((rated > 1.0).mean()),
    }

"""The best parameters of a law on a few episodes, found roughly: all candidates run in one batch.

The cross-entropy method (R. Y. Rubinstein, 1999): in each generation parameters are drawn around those of the best
quarter so far. From the best set the method of ``tuning.search`` takes some steps. That module finds the published
parameters more finely, on more episodes. Here they are fitted within seconds to the same episodes that are compared.
"""

from __future__ import annotations

import contextlib
import time
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from dcgrid_env import Scenario
from dcgrid_env.baselines.controller import Controller
from dcgrid_env.baselines.tuning.candidate_costs import episode_costs, mean_costs
from dcgrid_env.baselines.tuning.tunable import TUNABLE, Parameters

CANDIDATES, GENERATIONS, TRIALS = 24, 8, 100
_FEWEST = 8
_NODES = 4_000_000
"""Environments times nodes at most, for the memory that they take."""
_KEPT, _SPREAD, _ELITE = 0.3, 0.3, 4
_STARTS = {"droop": (1.0, float(np.log10(0.5)), float(np.log10(0.3)))}
"""Where searches begin: the droop at the paper's gains, others in the middle, where constant shares are 0."""


class Fitted(NamedTuple):
    """A law fitted to episodes."""

    controller: Controller
    parameters: Parameters
    J: float
    """Mean over the episodes."""


def fitted(name: str, scenario: Scenario, seeds: Sequence[int], until_s: float) -> Fitted:
    """Fit a law to episodes.

    Parameters
    ----------
    name
        A law of ``TUNABLE`` whose parameters are numbers, or tuples of one for each agent.
    scenario, seeds
        The episodes.
    until_s
        Time of ``time.monotonic`` after which no further generation begins; there is one in any case.
    """
    law = TUNABLE[name]
    low, high = np.array(law.bounds([scenario])).T
    rng = np.random.default_rng(0)
    middle = np.array(_STARTS.get(name, 0.5 * (low + high)))
    spread, best, best_j = _SPREAD * (high - low), middle, np.inf
    count = int(np.clip(_NODES / (len(seeds) * scenario.feeder.n_node), _FEWEST, CANDIDATES))
    for generation in range(GENERATIONS):
        if generation and time.monotonic() > until_s:
            break
        x = np.clip(middle + spread * rng.standard_normal((count, len(low))), low, high)
        x[0] = best
        j = mean_costs(law, scenario, [law.parameters(row, [scenario]) for row in x], seeds)
        order = np.argsort(j, kind="stable")[: max(2, count // _ELITE)]
        if j[order[0]] < best_j:
            best, best_j = x[order[0]], float(j[order[0]])
        middle = _KEPT * middle + (1.0 - _KEPT) * x[order].mean(axis=0)
        spread = _KEPT * spread + (1.0 - _KEPT) * x[order].std(axis=0)
    best, best_j = _polished(name, scenario, seeds, (low, high), (best, best_j), until_s)
    parameters = law.parameters(best, [scenario])
    return Fitted(law.law(**parameters), parameters, best_j)


def _polished(
    name: str,
    scenario: Scenario,
    seeds: Sequence[int],
    bounds: tuple[np.ndarray, np.ndarray],
    best: tuple[np.ndarray, float],
    until_s: float,
) -> tuple[np.ndarray, float]:
    """Parameters and mean J that COBYQA comes to from the best so far, as far as time and trials go."""
    from scipy.optimize import minimize

    (low, high), law = bounds, TUNABLE[name]
    tried = [best]

    def cost(share: np.ndarray) -> float:
        if time.monotonic() > until_s:
            raise _OutOfTime
        x = low + np.clip(share, 0.0, 1.0) * (high - low)
        j = float(episode_costs(scenario, law.law(**law.parameters(x, [scenario])), seeds).mean())
        tried.append((x, j))
        return j

    start = (best[0] - low) / (high - low)
    options = {"maxfev": TRIALS, "initial_tr_radius": 0.25, "final_tr_radius": 5e-3}
    with contextlib.suppress(_OutOfTime):
        minimize(cost, start, method="COBYQA", bounds=[(0.0, 1.0)] * len(low), options=options)
    return min(tried, key=lambda pair: pair[1])


class _OutOfTime(Exception):
    """No time is left for another trial."""

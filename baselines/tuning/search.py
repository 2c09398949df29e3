"""Find the parameters of a law on the validation split, so that every baseline is as good as possible.

The search minimises the mean J over episodes; on several scenarios together, it minimises the mean of J as a share of
the J of no control. It runs COBYQA (T. M. Ragonneau and Z. Zhang, a trust region of quadratic models without
derivatives) from the middle of the bounds. Laws of up to three parameters, and those whose cost has steps, are also
searched by differential evolution (R. Storn and K. Price, Journal of Global Optimization 11, 1997), and by COBYQA from
its best point. Both are the implementations of scipy. The same call finds the same parameters.

Set points are searched by the cross-entropy method (``core.cross_entropy``) on one scenario. A tap changes the cost by
a step, and all candidates run in one batch.

A droop must also be steady (``steadiness``). If the cheapest gains are not, the search is repeated with each set of
gains reduced until the closed loop is stable. The result is the cheapest set without a limit cycle.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from dcgrid_env import Scenario
from dcgrid_env.baselines.controller import Controller
from dcgrid_env.baselines.laws.droop import Droop
from dcgrid_env.baselines.laws.no_control import NoControl
from dcgrid_env.baselines.laws.stability import ClosedLoops, is_stable
from dcgrid_env.baselines.rollout import rollout
from dcgrid_env.baselines.tuning.candidate_costs import mean_costs
from dcgrid_env.baselines.tuning.steadiness import drawn_back, has_limit_cycle
from dcgrid_env.baselines.tuning.tunable import TUNABLE, Parameters, Tunable
from dcgrid_env.core.cross_entropy import CrossEntropy
from dcgrid_env.core.suggestions import unknown


class Tuned(NamedTuple):
    """Result of a search."""

    parameters: Parameters
    score: float
    """Mean J; over several scenarios, the mean of J as a share of the J of no control."""
    trials: int
    spectral_radius: float | None = None
    """Spectral radius of a droop's closed loop (:class:`laws.stability.ClosedLoops`); None for other laws."""
    overrides: Mapping[str, Any] = {}
    """Fields of the scenario that the parameters require, see ``Scenario.replace``."""


class Trial(NamedTuple):
    """A set of parameters that was tried."""

    cost: float
    parameters: Parameters


def tune(
    name: str, scenarios: Sequence[Scenario], episodes: int = 20, on_trial: Callable[[], None] | None = None
) -> Tuned:
    """Find the best parameters of a law.

    Parameters
    ----------
    name
        Name of the law, one of TUNABLE.
    scenarios
        Scenarios to tune on, which should be on the validation split. Several scenarios share one set of parameters.
    episodes
        Number of episodes of each scenario, with seeds 0 to episodes - 1.
    on_trial
        Function called after each set of parameters, for progress.

    Raises
    ------
    ValueError
        If the law cannot be tuned (the message lists those that can), or scenarios or episodes are missing. Also if a
        droop is unstable or has a limit cycle at all gains that were tried. A ``ControllerError`` if the law refuses a
        scenario or fails.
    """
    if name not in TUNABLE:
        raise ValueError(unknown("tunable law", name, TUNABLE, f"there are {', '.join(TUNABLE)}"))
    if not scenarios or episodes < 1:
        raise ValueError(f"tune: {len(scenarios)} scenarios and {episodes} episodes; give at least one of each")
    law = TUNABLE[name]
    trials = _search(law, scenarios, episodes, law.parameters, on_trial)
    if law.law is not Droop:
        best = min(trials, key=_cost)
        overrides = law.overrides(scenarios[0], best.parameters)
        return Tuned(best.parameters, best.cost, len(trials), overrides=overrides)
    loops = ClosedLoops(scenarios)

    def is_steady(trial: Trial) -> bool:
        droop = Droop(**trial.parameters)
        stable = is_stable(loops.largest_radius(droop))
        return stable and not any(has_limit_cycle(s, droop, episodes) for s in scenarios)

    fittest, tried = min(trials, key=_cost), len(trials)
    if not is_steady(fittest):
        trials = _search(law, scenarios, episodes, lambda x, on: drawn_back(loops, law.parameters(x, on)), on_trial)
        tried += len(trials)
        fittest = next((trial for trial in sorted(trials, key=_cost) if is_steady(trial)), None)
        if fittest is None:
            raise ValueError(f"tune: {name!r} is not stable on {scenarios[0].name} at any of {tried} sets of gains")
    return Tuned(fittest.parameters, fittest.cost, tried, loops.largest_radius(Droop(**fittest.parameters)))


def _search(
    law: Tunable,
    scenarios: Sequence[Scenario],
    episodes: int,
    parameters: Callable[[np.ndarray, Sequence[Scenario]], Parameters],
    on_trial: Callable[[], None] | None,
) -> list[Trial]:
    """Every set of parameters that the search tries."""
    from scipy.optimize import differential_evolution, minimize

    low, high = np.array(law.bounds(scenarios)).T
    if law.by_cross_entropy:
        return _by_cross_entropy(law, scenarios, episodes, on_trial)
    is_single = len(scenarios) == 1
    j_free = [1.0] if is_single else [mean_cost(s, NoControl(), episodes) for s in scenarios]
    tried: list[tuple[Trial, np.ndarray]] = []

    def score(share: np.ndarray) -> float:
        """Cost of parameters at these shares of the way from their lower to their upper bounds."""
        share = np.clip(share, 0.0, 1.0)  # methods overstep by rounding
        candidate = parameters(low + share * (high - low), scenarios)
        controller = law.law(**candidate)
        cost = float(np.mean([mean_cost(s, controller, episodes) / j for s, j in zip(scenarios, j_free, strict=True)]))
        tried.append((Trial(cost, candidate), share))
        if on_trial is not None:
            on_trial()
        return cost

    n = len(low)
    starts = [np.full(n, 0.5)]
    generations = (3 if n <= 3 else 0) if law.generations is None else law.generations
    if generations:
        seeded: dict[str, Any] = {"seed": 0}  # newer releases of scipy also call it rng
        try:
            differential_evolution(score, [(0.0, 1.0)] * n, popsize=8, maxiter=generations, polish=False, **seeded)
        except RuntimeError as error:
            if isinstance(error.__cause__, ValueError):  # which scipy hides behind words about its own arguments
                raise error.__cause__ from None
            raise
        starts.append(min(tried, key=lambda pair: pair[0].cost)[1])
    budget = {"maxfev": 30 * n, "initial_tr_radius": 0.25, "final_tr_radius": 5e-4}
    for start in starts:
        minimize(score, start, method="COBYQA", bounds=[(0.0, 1.0)] * n, options=budget)
    return [trial for trial, _ in tried]


CANDIDATES, ELITES, ITERATIONS = 48, 8, 40
"""Sets of parameters in an iteration of the cross-entropy method, those that determine the next, and iterations."""
_STD, _EXTRA_STD = 0.25, 0.05
"""Initial and extra standard deviation, as shares of the bounds."""
_SETTLED_STD = 1e-3
"""Standard deviation of all parameters below which the search ends."""


def _by_cross_entropy(
    law: Tunable, scenarios: Sequence[Scenario], episodes: int, on_trial: Callable[[], None] | None
) -> list[Trial]:
    """Every set of parameters that the cross-entropy method tries on one scenario."""
    (scenario,), bounds = scenarios, np.array(law.bounds(scenarios))
    distribution = CrossEntropy(np.full(len(bounds), 0.5), _STD, _EXTRA_STD, ELITES)
    trials: list[Trial] = []
    for iteration in range(1, ITERATIONS + 1):
        shares = distribution.candidates(np.random.default_rng([0, iteration]), CANDIDATES).clip(0.0, 1.0)
        sets = [law.parameters(bounds[:, 0] + share * np.ptp(bounds, axis=1), scenarios) for share in shares]
        costs = mean_costs(law, scenario, sets, range(episodes))
        distribution.update(shares, costs, iteration / ITERATIONS)
        trials += map(Trial, costs.tolist(), sets)
        if on_trial is not None:
            for _ in sets:
                on_trial()
        if distribution.std.max() < _SETTLED_STD:
            break
    return trials


def _cost(trial: Trial) -> float:
    return trial.cost


def mean_cost(scenario: Scenario, controller: Controller, episodes: int) -> float:
    """Mean J over the episodes of seeds 0, 1, .."""
    return float(rollout(scenario, controller, range(episodes)).costs().mean())

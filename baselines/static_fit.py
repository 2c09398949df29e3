"""Finds the static rules' parameters on the validation split: ``python -m dcgrid_env.baselines.static_fit``.

``fit`` does it for any scenario and any law, say one share for each agent:

    fit([make_scenario("toy6", split="validation")], lambda x: ConstantQ(tuple(x)), [(-1.0, 1.0)] * 3)
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from dcgrid_env import PRESETS, Scenario, make_scenario
from dcgrid_env.baselines.controller import Controller
from dcgrid_env.baselines.none import NoControl
from dcgrid_env.baselines.rollout import rollout
from dcgrid_env.baselines.static import ConstantQ, PlacementRule


def mean_j(scenario: Scenario, controller: Controller, episodes: int) -> float:
    """Mean J over the episodes of seeds 0, 1, .."""
    return float(np.mean([m["J"] for m in rollout(scenario, controller, range(episodes)).metrics()]))


def fit(
    scenarios: Sequence[Scenario],
    make: Callable[[np.ndarray], Controller],
    bounds: Sequence[tuple[float, float]],
    episodes: int = 20,
) -> tuple[Controller, float]:
    """The controller with the least J.

    Parameters
    ----------
    scenarios
        On which; their split should be validation.
    make
        From parameters to a controller.
    bounds
        Lowest and highest value of each parameter.
    episodes
        Of each scenario.

    Returns
    -------
    controller, score
        The best found (differential evolution, Storn and Price 1997, seeded) and the mean over the scenarios of
        J / J of no control.
    """
    from scipy.optimize import differential_evolution

    none = [mean_j(s, NoControl(), episodes) for s in scenarios]

    def score(x: np.ndarray) -> float:
        return float(np.mean([mean_j(s, make(x), episodes) / j for s, j in zip(scenarios, none, strict=True)]))

    seeded: dict[str, Any] = {"seed": 0}  # newer releases of scipy also call it rng
    found = differential_evolution(score, bounds, popsize=6, maxiter=15, tol=1e-4, polish=False, **seeded)
    return make(found.x), float(found.fun)


def _one(x: np.ndarray) -> ConstantQ:
    return ConstantQ(round(float(x[0]), 3))


def _rule(x: np.ndarray) -> PlacementRule:
    return PlacementRule(round(float(x[0]), 3), round(float(x[1]), 2), round(float(x[2]), 2))


def main() -> None:
    """Print what is best over all presets, the defaults of ``static``, and what is best on each alone."""
    presets = [make_scenario(name, split="validation") for name in PRESETS]
    laws = ((_one, [(-1.0, 1.0)]), (_rule, [(-1.0, 1.0), (-60.0, 60.0), (-60.0, 60.0)]))
    for scenarios in (presets, *([s] for s in presets)):
        for make, bounds in laws:
            controller, score = fit(scenarios, make, bounds)
            print(", ".join(s.name for s in scenarios), controller, f"J / J of no control {score:.4f}", flush=True)


if __name__ == "__main__":
    main()

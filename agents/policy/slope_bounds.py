"""How steep a controller's answer to its own voltage may be on a scenario: the linear stability bound by its agents.

With X and R in bands per share of the agents' ratings, d the data centres, and m the age of the measurement in steps:

    reactive power    slope lambda_max(D^1/2 X D^1/2) < 2 sin(pi / (2 (2 m + 1)))     the integrating droop's
    clock             slope rho(R_dd) < 1 / 2                                         the proportional droop's

The second is that of ``baselines.laws.stability`` with alpha dt = 1: deferred work is requested again a step later. The
first with m steps of delay is where a root of z^(m+1) - z^m + k leaves the unit circle. Each holds for its axis alone,
on the linearised feeder.
"""

from __future__ import annotations

import numpy as np

from dcgrid_env import Feeder, RandomFeeders, Scenario, sensitivity_between_agents
from dcgrid_env.baselines.laws.stability import placements

PLACEMENTS = 1000
"""Seeds whose placements are looked at where a scenario draws them."""


def slope_bounds(scenario: Scenario, n: int = PLACEMENTS) -> tuple[float, float]:
    """Largest stable slope of reactive power and of the clock, in units of the action for each band of voltage.

    The smallest over the placements of the first ``n`` seeds; infinite without agents of the kind.
    ValueError for random feeders, as each has another bound.
    """
    if isinstance(scenario.feeder, RandomFeeders):
        raise ValueError(
            f"safe: the bound on gains is that of one feeder, and {scenario.name} has random ones; train analytic, or "
            "give another feeder"
        )
    index = scenario.feeder.index
    kinds = np.array([device.kind for device in scenario.devices for _ in range(device.count)])
    sites = np.flatnonzero(kinds == "datacenter")
    largest = _eigenvalue if isinstance(scenario.feeder, Feeder) else _singular_value
    q_mvar = scenario.q_scale_kvar / 1e3
    # Half the range of actions moves half the power between the slowest clock and the top.
    p_mw = (
        0.5
        * (1.0 - scenario.datacenters.f_min_mhz / scenario.datacenters.f_max_mhz)
        * scenario.datacenters.parameters.p_dynamic_kw
        / 1e3
    )
    late = np.sin(np.pi / (2 * (2 * scenario.sensing.delay_steps + 1)))
    slopes = []
    for buses in placements(scenario, n):
        positions = np.array([[index(bus) for bus in buses]])
        r, x = (by[0] / (scenario.cost.band_pu or 1.0) for by in sensitivity_between_agents(scenario, positions))
        x_scaled = np.sqrt(q_mvar)[:, None] * x * np.sqrt(q_mvar)
        r_scaled = np.sqrt(p_mw)[:, None] * r[np.ix_(sites, sites)] * np.sqrt(p_mw)
        of_clock = 0.5 / largest(r_scaled) if len(sites) else np.inf
        slopes.append((2.0 * late / largest(x_scaled) if q_mvar.any() else np.inf, of_clock))
    reactive, clock = np.min(slopes, axis=0)
    return float(reactive), float(clock)


def _eigenvalue(matrix: np.ndarray) -> float:
    """Largest eigenvalue of a balanced feeder's sensitivities, which are symmetric."""
    return np.linalg.eigvalsh(matrix)[-1]


def _singular_value(matrix: np.ndarray) -> float:
    """Largest singular value, no less than any eigenvalue: a three-phase feeder's sensitivities are not symmetric."""
    return float(np.linalg.norm(matrix, 2))

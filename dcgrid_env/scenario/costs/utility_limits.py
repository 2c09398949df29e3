"""Limits of a utility on what a site and a step may do: how far its ramp and a change of voltage exceed them.

    ramp_t           = |P_t - P_{t-w}| / w           of a site's draw at the grid, kW/s, w = ramp_window_s
    ramp excess      = max(ramp_t / ramp_limit - 1, 0)
    voltage excess   = max(|V_t - V_{t-1}| / voltage_step_limit - 1, 0)

Before an episode a site has always drawn what it draws at t = 0. A site that a fault disconnects ramps too. Both are
constraints in ``info["cost"]`` where they have a weight (see ``CostWeights``), and metrics where there is a limit.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from dcgrid_env.core.arrays import Array, namespace, positive_part
from dcgrid_env.core.cache import cached_on_owner


@cached_on_owner
def ramp_steps(scenario: Any) -> int:
    """Number of steps that a ramp is averaged over."""
    return 1 if scenario.cost.ramp_window_s is None else round(scenario.cost.ramp_window_s / scenario.dt_s)


@cached_on_owner
def remembered_draws(scenario: Any) -> int:
    """Number of steps whose draws a state keeps, ``State.p_window_kw``; 0 where no ramp is charged."""
    return ramp_steps(scenario) if scenario.cost.weights.ramp_excess else 0


@cached_on_owner
def sites(scenario: Any) -> slice:
    """Return the positions of the agents that the workload drives; at most one group of devices is driven by it."""
    of_sites = [device.input == "workload" for device in scenario.devices for _ in range(device.count)]
    positions = np.flatnonzero(of_sites)
    return slice(int(positions[0]), int(positions[-1]) + 1) if len(positions) else slice(0, 0)


def ramps_kw_per_s(scenario: Any, p_kw: Array, p_before_kw: Array) -> Array:
    """Mean rise or fall of draws over the window, kW/s, from those at its end and at its beginning."""
    return namespace(p_kw).abs(p_kw - p_before_kw) / (ramp_steps(scenario) * scenario.dt_s)


def excess(amount: Array, limit: float) -> Array:
    """What lies beyond a limit, as a share of it."""
    return positive_part(amount / limit - 1.0)


def ramp_excess(scenario: Any, state: Any) -> Array:
    """What the ramp of each site exceeds the scenario's limit by, as a share of it, (row, n_site)."""
    site_slice, begin, limit = sites(scenario), state.p_window_kw, scenario.cost.ramp_limit_kw_per_s
    if begin is None or limit is None:
        raise ValueError(f"scenario {scenario.name!r} charges no ramps; give cost.ramp_limit_kw_per_s and its weight")
    return excess(ramps_kw_per_s(scenario, state.p_kw[..., site_slice], begin[0][..., site_slice]), limit)


def voltage_step_excess(scenario: Any, v_pu: Array, v_last_pu: Array) -> Array:
    """What changes of voltage exceed the scenario's limit by, as a share of it, elementwise."""
    limit = scenario.cost.voltage_step_limit_pu
    if limit is None:
        raise ValueError(f"scenario {scenario.name!r} has no limit on voltage changes; give cost.voltage_step_limit_pu")
    return excess(namespace(v_pu).abs(v_pu - v_last_pu), limit)


def largest_ramp_excess(scenario: Any) -> float:
    """Upper bound of the excess of any site's ramp: from the most that it can give to the most that it can draw."""
    limit = scenario.cost.ramp_limit_kw_per_s
    if limit is None:
        return 0.0
    groups = [device for device in scenario.devices if device.input == "workload"]
    swings = [group.largest_draw_share + getattr(group, "largest_export_share", 0.0) for group in groups]
    largest_kw = max(swings, default=0.0) * float(scenario.site_rated_kw.max(initial=0.0))
    return max(largest_kw / (ramp_steps(scenario) * scenario.dt_s) / limit - 1.0, 0.0)


def largest_voltage_step_excess(scenario: Any) -> float:
    """Upper bound of the excess of a change of voltage: from end to end, as ``step`` has it."""
    limit = scenario.cost.voltage_step_limit_pu
    return 0.0 if limit is None else max(1.0 / limit - 1.0, 0.0)

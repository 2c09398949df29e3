"""One pass of compiled code over the lanes of a balanced feeder, in place of one for each part of it.

A lane's loads are drawn, its agents' powers are added, its power flow is solved and its voltages are summed up while
all of it is in the processor's cache, and lanes are spread over threads once a step. Each part is the kernel that also
stands alone (``core.random.load_step``, ``powerflow.balanced.compiled``, ``voltage_figures``), and so are the bits.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Any, NamedTuple

import numba
import numpy as np

from dcgrid_env.core.cache import cached_on_owner
from dcgrid_env.core.random import load_step
from dcgrid_env.core.threads import over_lanes
from dcgrid_env.core.units import S_BASE_KVA
from dcgrid_env.engine.state import LoadsToDraw
from dcgrid_env.engine.step_kernels import net_loads
from dcgrid_env.engine.voltage_figures import VoltageFigures, fill_figures
from dcgrid_env.grid import Feeder
from dcgrid_env.powerflow import has_ratings
from dcgrid_env.powerflow.balanced.batch import constants, rows
from dcgrid_env.powerflow.balanced.compiled import distflow_lanes
from dcgrid_env.powerflow.balanced.distflow import MAX_SWEEPS, TOLERANCE_KVA
from dcgrid_env.powerflow.solution import raise_not_finite
from dcgrid_env.scenario.scenario import Scenario

CHUNK = 64  # lanes whose loads stand in the cache together


class GridPass(NamedTuple):
    """What a pass leads to; the fields that ``Solution`` has mean the same."""

    v_pu: np.ndarray
    restart: np.ndarray
    loss_kw: np.ndarray
    converged: np.ndarray
    figures: VoltageFigures
    noise: np.ndarray
    """The load noise at the end of the interval, (lane, n_bus)."""


@cached_on_owner
def fits(scenario: Scenario) -> bool:
    """Whether a pass does all that a step asks of the grid: plain DistFlow, and nothing that changes the grid."""
    feeder = scenario.feeder
    plain = type(feeder) is Feeder and scenario.power_flow == "distflow" and not has_ratings(feeder)
    return plain and not scenario.faults and not any(device.changes_grid for device in scenario.devices)


def grid_pass(
    scenario: Scenario, drawing: LoadsToDraw, nodes: Any, p_kw: Any, q_kvar: Any, restart: np.ndarray
) -> GridPass:
    """Draw the loads of an interval and solve the grid under the agents' powers, kW and kvar, (lane, n_agent).

    ``nodes`` are those of ``Exogenous``; the power flow starts from ``restart``. PowerFlowError for a power that is
    not finite.
    """
    feeder: Any = scenario.feeder
    lanes, n = drawing.noise.shape
    agents, warm = (lanes, p_kw.shape[1]), rows(restart, (lanes, n - 1))
    given = (
        *drawing[:4],
        nodes,
        rows(p_kw, agents),
        rows(q_kvar, agents),
        _all(lanes, scenario.source_voltage_pu),
        warm,
    )
    over_buses = np.empty((2, lanes, n))
    per_lane = np.empty((6, lanes))
    noise, v_pu, after = over_buses[0], over_buses[1], np.empty((lanes, n - 1))
    converged = np.empty(lanes, np.bool_)
    out = (noise, v_pu, after, converged, np.empty(lanes, np.int64), *per_lane)
    fixed = (constants(feeder, np.float64), drawing[4:], feeder.load_slice.start, scenario.band_pu)

    def part(first: int, last: int) -> int:
        return _lanes(first, last, *fixed, given, out)

    if (part(0, lanes) if lanes == 1 else over_lanes(part, lanes)) and not np.isfinite(p_kw + q_kvar).all():
        loads = np.empty((3, lanes, n))
        load_step(*drawing, *loads)
        raise_not_finite(feeder, *net_loads(loads[1], loads[2], nodes, *given[5:7]))
    return GridPass(v_pu, after, per_lane[0], converged, VoltageFigures(*per_lane[2:]), noise)


@numba.njit(nogil=True, error_model="numpy", cache=True)
def _lanes(first, last, of_feeder, load, judged, band_pu, given, out):
    """The pass over the lanes from ``first`` up to ``last``; how many of them have no solution."""
    order, parent, r, x, shunt_g, shunt_b, ratio = of_feeder
    rho, sigma, p_base, q_base, q_fixed = load
    key, step, noise, share, nodes, p_agent, q_agent, v0_pu, warm = given
    noise_out, v_pu, restart, converged, sweeps, loss, residual, deviation, excess, lowest, highest = out
    n, failed, parts = noise.shape[1], 0, nodes.shape[2]
    none = np.empty((0, 0))
    p, q = np.empty((min(CHUNK, last - first), n)), np.empty((min(CHUNK, last - first), n))
    for a in range(first, last, CHUNK):
        b = min(a + CHUNK, last)
        p_net, q_net = p[: b - a], q[: b - a]
        load_step(
            key[a:b],
            step[a:b],
            noise[a:b],
            share[a:b],
            rho,
            sigma,
            p_base,
            q_base,
            q_fixed,
            noise_out[a:b],
            p_net,
            q_net,
        )
        for lane in range(a, b):
            for agent in range(nodes.shape[1]):
                for part in range(parts):
                    at = nodes[lane, agent, part] - lane * n
                    p_net[lane - a, at] += p_agent[lane, agent] / parts
                    q_net[lane - a, at] += -q_agent[lane, agent] / parts
        solved = (v_pu[a:b], none, none, restart[a:b], loss[a:b], converged[a:b], sweeps[a:b], residual[a:b])
        failed += distflow_lanes(
            order,
            parent,
            r,
            x,
            shunt_g,
            shunt_b,
            ratio,
            p_net,
            q_net,
            v0_pu[a:b],
            warm[a:b],
            TOLERANCE,
            MAX_SWEEPS,
            solved,
        )
        fill_figures(v_pu, a, b, judged, band_pu, deviation, excess, lowest, highest)
    return failed


TOLERANCE = TOLERANCE_KVA[8] / S_BASE_KVA


@lru_cache(maxsize=64)
def _all(lanes: int, v0_pu: float) -> np.ndarray:
    return np.full(lanes, v0_pu)

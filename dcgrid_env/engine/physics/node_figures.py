"""What a step takes of a power flow: voltages at the agents, and figures of the phases of a three-phase feeder."""

from __future__ import annotations

from functools import cache
from typing import Any, NamedTuple

import numpy as np

from dcgrid_env.core.arrays import Array, take_at
from dcgrid_env.core.cache import cached_on_owner
from dcgrid_env.engine.physics.state import VoltageFigures
from dcgrid_env.powerflow import branch_loading, has_ratings, three_phase_nodes, unbalance_factor
from dcgrid_env.powerflow.loading import inverse_ratings, rated_places
from dcgrid_env.powerflow.unbalanced.three_phase_solution import ThreePhaseSolution
from dcgrid_env.scenario.scenario import Scenario


class PhaseFigures(NamedTuple):
    """Figures of a power flow of a three-phase feeder."""

    v_agent_pu: Array
    """Mean voltage of each agent's nodes, p.u., (row, n_agent)."""
    lowest_pu: Array
    """Voltage of its lowest phase."""
    highest_pu: Array
    """Voltage of its highest phase."""
    unbalance: Array
    """Voltage unbalance factor of each three-phase bus, (row, n_three_phase_bus)."""
    loading: Array | None
    """See ``State.loading``."""
    voltages: VoltageFigures | None
    """Sums and extremes over nodes; None where costs compute them from the voltages, as they do of tensors."""


def phase_figures(scenario: Scenario, solution: ThreePhaseSolution, nodes: Array) -> PhaseFigures:
    """Return the figures of a power flow; ``nodes`` are those of the agents, see ``Exogenous``."""
    feeder: Any = scenario.feeder
    v_pu, v_re_pu, v_im_pu, i_re_a, i_im_a = solution[:5]
    if type(v_pu) is not np.ndarray or v_pu.dtype != np.float64:
        unbalance = unbalance_factor(three_phase_nodes(feeder), v_re_pu, v_im_pu)
        loading = branch_loading(feeder, solution) if has_ratings(feeder) else None
        return PhaseFigures(from_nodes(v_pu, nodes), *node_extremes(v_pu, nodes), unbalance, loading, None)
    kernel = step_kernels().phase_figures
    return as_figures(scenario, *kernel(v_pu, v_re_pu, v_im_pu, i_re_a, i_im_a, nodes, *constants(scenario)))


def as_figures(
    scenario: Scenario, agents: np.ndarray, unbalance: np.ndarray, loading: np.ndarray, per_row: np.ndarray
) -> PhaseFigures:
    """Return what the kernel ``step_kernels.phase_figures`` gives by name."""
    voltages = VoltageFigures(per_row[0], per_row[1], per_row[2], per_row[3])
    loading_or_none = loading if has_ratings(scenario.feeder) else None
    return PhaseFigures(agents[0], agents[1], agents[2], unbalance, loading_or_none, voltages)


@cached_on_owner
def constants(scenario: Scenario) -> tuple[Any, ...]:
    """Return the last arguments of the kernel ``step_kernels.phase_figures``, which are constants of a scenario."""
    feeder: Any = scenario.feeder
    rated, regulated, before, _ = rated_places(feeder, np, "cpu")
    before = np.concatenate((rated[: len(rated) - len(regulated)], before))
    ratings = rated, before, inverse_ratings(feeder)[rated]
    judged = feeder.load_slice.start, float(scenario.cost.band_pu)
    return (three_phase_nodes(feeder), *ratings, *judged)


@cache
def step_kernels() -> Any:
    """The compiled kernels of a step, imported on first use: they bring the compiler with them."""
    from dcgrid_env.engine.physics import step_kernels as kernels

    return kernels


def from_nodes(v_pu: Array, nodes: Array) -> Array:
    """Each agent's voltage, the mean of its nodes', (row, n_agent)."""
    v_nodes = take_at(v_pu, nodes)
    return v_nodes[..., 0] if nodes.shape[-1] == 1 else v_nodes.sum(-1) / nodes.shape[-1]


def node_extremes(v_pu: Array, nodes: Array) -> tuple[Array, Array]:
    """Lowest and highest voltage of each agent's nodes, (row, n_agent) each."""
    v_nodes = take_at(v_pu, nodes)
    return (
        (v_nodes.min(-1), v_nodes.max(-1)) if isinstance(v_nodes, np.ndarray) else (v_nodes.amin(-1), v_nodes.amax(-1))
    )

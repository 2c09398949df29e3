"""Contents of ``info``: flat, finite, the same keys at every step, and at every reset those that belong to no step."""

from __future__ import annotations

from collections.abc import Iterator
from functools import cache
from typing import TYPE_CHECKING, Any, Literal, get_args

import numpy as np

from dcgrid_env.core.cache import cached_on_owner
from dcgrid_env.devices.device import step_totals
from dcgrid_env.engine.cost.reward import constraint
from dcgrid_env.engine.physics.state import Equipment
from dcgrid_env.grid import ThreePhaseFeeder
from dcgrid_env.scenario.costs.load_requests import columns, missed, rated_kw
from dcgrid_env.scenario.scenario import Scenario

if TYPE_CHECKING:
    from dcgrid_env.engine.simulation import Transition

InfoLevel = Literal["none", "costs", "full"]
"""Levels of ``info``: nothing, the cost terms and J, or all figures and the agents' buses."""

INFO_LEVELS: tuple[InfoLevel, ...] = get_args(InfoLevel)


@cache
def _keys(kind: Any) -> tuple[str, ...]:
    """Keys of the constraint, of all cost terms, and of J."""
    return ("cost", *(f"cost_{name}" for name in kind._fields), "J")


_STEP_KEYS = ("cost", "J", "reward_vector", "tap_moves", "capacitor_switchings")


@cached_on_owner
def step_keys(scenario: Scenario, keys: tuple[str, ...]) -> tuple[str, ...]:
    """Return those of the keys that belong to a step, with no figures at a reset: costs, J, rewards and events."""
    events = {name for device in scenario.devices for name in step_totals(device)}
    return tuple(key for key in keys if key in _STEP_KEYS or key.startswith("cost_") or key in events)


def drop_step_keys(scenario: Scenario, info: dict[str, Any]) -> None:
    """Remove what belongs to a step, and its masks, from the info of a reset."""
    for key in step_keys(scenario, tuple(info)):
        del info[key]
        info.pop(f"_{key}", None)


def info_arrays(scenario: Scenario, transition: Transition, level: InfoLevel = "full") -> dict[str, np.ndarray]:
    """Figures of a step, each (row,), float64; ``power_flow_converged`` is 1 or 0.

    After a reset, those of ``step_keys`` are 0, and the environments remove them.

    ``cost_*`` are the weighted terms as charged, their sum is minus the team's reward; ``cost`` is the violation, what
    exceeds a limit, and trips where these have a weight, for constrained learning. ``J`` is the cost so far as a share
    of the episode's: the sum of all terms since the reset over T, and so in an episode's last step its J. Voltages are
    over buses other than the substation.
    """
    if level == "none":
        return {}
    costs = transition.costs
    figures = dict(zip(_keys(type(costs)), (constraint(scenario, costs), *costs, transition.j_so_far), strict=True))
    if level == "costs":
        return figures
    state = transition.state
    figures["power_flow_converged"] = transition.converged.astype(np.float64)
    figures["voltage_min_pu"] = transition.voltages.lowest_pu
    figures["voltage_max_pu"] = transition.voltages.highest_pu
    if state.three_phase is not None:
        figures["unbalance_max_pct"] = 100.0 * np.maximum.reduce(state.three_phase.unbalance, -1, initial=0.0)
        figures.update(_of_equipment(scenario.feeder, state.three_phase.equipment))
    for i, its_state in enumerate(state.devices):
        if its_state:
            figures.update(scenario.devices[i].totals(its_state))
    if state.request is not None:
        request, rated = columns(state.request), rated_kw(scenario)
        figures["grid_request_lower_kw"] = rated * request.lower
        figures["grid_request_upper_kw"] = rated * request.upper
        figures["grid_request_missed_kw"] = rated * missed(scenario, state)
    figures["loss_kw"] = transition.loss_kw
    return figures


def _of_equipment(feeder: ThreePhaseFeeder, equipment: Equipment) -> Iterator[tuple[str, np.ndarray]]:
    """Give the moves in the step, and the position of each regulator and capacitor bank of a three-phase feeder."""
    regulators, banks = equipment
    moves = np.add.reduce(regulators.moved, -1), np.add.reduce(banks.switched, -1)
    return zip(_equipment_keys(feeder), (*moves, *regulators.tap.T, *banks.on.T), strict=True)


@cached_on_owner
def _equipment_keys(feeder: ThreePhaseFeeder) -> tuple[str, ...]:
    taps = (f"tap_{name}" for name in feeder.network.regulator.name)
    banks = (f"capacitor_{name}" for name in feeder.network.capacitor.name)
    return ("tap_moves", "capacitor_switchings", *taps, *banks)

"""Moves of regulators and capacitor banks in a step, as a mean over those that are not fixed."""

from __future__ import annotations

from typing import Any

import numpy as np

from dcgrid_env.core.arrays import Array, as_like, namespace, sum_last
from dcgrid_env.core.cache import cached_on_owner
from dcgrid_env.devices.grid_equipment import is_equipment
from dcgrid_env.devices.tap_changer.relay import relay_settings
from dcgrid_env.scenario.grid_control import capacitor_deciders, regulator_deciders


@cached_on_owner
def _deciders(scenario: Any) -> np.ndarray:
    """Who decides over each regulator, then over each capacitor bank, (n_regulator + n_capacitor,) of text."""
    control, feeder = scenario.grid_control, scenario.feeder
    return np.array([*regulator_deciders(control, feeder), *capacitor_deciders(control, feeder)], "U10")


@cached_on_owner
def moving_equipment(scenario: Any) -> np.ndarray:
    """1 for equipment that is not fixed, else 0, (n_regulator + n_capacitor,)."""
    return (_deciders(scenario) != "fixed").astype(np.float64)


@cached_on_owner
def _n_moving(scenario: Any) -> int:
    """Number of regulators and capacitor banks that are not fixed, at least 1."""
    return max(int(moving_equipment(scenario).sum()), 1)


def mean_switching(scenario: Any, equipment: Any) -> Array:
    """Mean number of taps and switchings in the step of the equipment that is not fixed, (row,)."""
    moved, switched, moving = equipment.regulators.moved, equipment.banks.switched, moving_equipment(scenario)
    n = moved.shape[-1]
    return (moved @ as_like(moving[:n], moved) + switched @ as_like(moving[n:], moved)) / _n_moving(scenario)


def price_of_move(scenario: Any) -> float:
    """Return the cost of one tap or switching, in units of the cost of a step."""
    return scenario.cost.weights.switching / _n_moving(scenario)


def switching_of_agents(scenario: Any, state: Any) -> Array:
    """Each agent's moves, and for every agent the mean number of moves by controls of equipment, (row, n_agent)."""
    moves, zero = _moves(state.three_phase.equipment), 0.0 * state.v_agent_pu
    controlled = sum_last(moves * as_like((_deciders(scenario) == "controlled").astype(np.float64), moves))
    parts, begin = [], 0
    for device, of_device in zip(scenario.devices, state.devices, strict=True):
        end = begin + device.count
        if is_equipment(device):
            parts.append(of_device.moved if hasattr(of_device, "moved") else of_device.switched)
        else:
            parts.append(zero[..., begin:end])
        begin = end
    return zero + (controlled / _n_moving(scenario))[..., None] + namespace(zero).concat(parts, axis=-1)


def largest_switching(scenario: Any) -> float:
    """Upper bound of the mean: every regulator from end to end, every bank switched."""
    settings = relay_settings(scenario.feeder)
    most = np.concatenate((settings.highest - settings.lowest, np.ones(scenario.feeder.n_capacitor)))
    return float((most * moving_equipment(scenario)).sum() / _n_moving(scenario))


def _moves(equipment: Any) -> Array:
    moved, switched = equipment.regulators.moved, equipment.banks.switched
    return namespace(moved).concat((moved, switched), axis=-1)

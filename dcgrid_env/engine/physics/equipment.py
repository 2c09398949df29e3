"""The regulators and capacitor banks of a three-phase feeder over an episode: controlled, agents, or fixed.

At the beginning of a step, a control acts on measurements from the power flow of the previous step, and an agent's
equipment on the agent's action. Taps and switches are then constant over the step. At t = 0 the taps of controlled
regulators have settled.
"""

from __future__ import annotations

from collections.abc import Sequence
from types import ModuleType
from typing import Any, NamedTuple

import numpy as np

from dcgrid_env.core.arrays import Array, namespace, take_last
from dcgrid_env.core.cache import cached_on_owner
from dcgrid_env.devices.capacitor_bank.capacitor_banks import CapacitorBanks
from dcgrid_env.devices.capacitor_bank.capacitor_control import (
    bank_settings,
    control_banks,
    initial_banks,
    measured_banks,
)
from dcgrid_env.devices.tap_changer.relay import relay_settings, relay_volts, settings_like
from dcgrid_env.devices.tap_changer.settling import settled_taps
from dcgrid_env.devices.tap_changer.tap_changers import TapChangers
from dcgrid_env.devices.tap_changer.tap_control import control_taps, initial_regulators
from dcgrid_env.engine.physics.state import Equipment
from dcgrid_env.powerflow import Control
from dcgrid_env.powerflow.unbalanced.three_phase_solution import ThreePhaseSolution
from dcgrid_env.scenario.grid_control import capacitor_deciders, regulator_deciders
from dcgrid_env.scenario.scenario import Scenario


class _Group(NamedTuple):
    """The regulators or the banks of a feeder."""

    settings: Any
    """``RelaySettings`` or ``BankSettings``."""
    controlled: Array
    """1 where a control acts, (n,)."""
    acts: bool
    """Whether a control acts on any of them; otherwise banks have neither measurements nor timers."""
    agents: int | None
    """Position among the scenario's devices of the group that is agents."""
    pick: Array
    """Index of each piece in the feeder's pieces followed by those of the agents, int, (n,)."""


class _Plan(NamedTuple):
    regulators: _Group
    banks: _Group


def begun(
    scenario: Scenario, p_kw: Array, q_kvar: Array, shunt_kvar: Array | None, connected: Array | None
) -> Equipment:
    """The equipment at t = 0 under the legs' net loads: taps settled, each row by itself.

    Shapes are (row, n_leg) of the loads, (row, n_node) of switched shunts, None without any, and (row, n_capacitor)
    of what is ``connected``, None where all banks are.
    """
    feeder, plan = _feeder(scenario), _plan(scenario, p_kw)
    zeros = 0.0 * p_kw[..., :1]
    tap, on = (zeros + _like(values, p_kw) for values in (feeder.base_tap, feeder.base_capacitor_on))
    if plan.regulators.acts:
        control = Control(None, shunt_kvar, on if connected is None else on * connected)
        given = (feeder, p_kw, q_kvar, scenario.source_voltage_pu, control)
        tap = settled_taps(*given, controlled=plan.regulators.controlled).tap
    return Equipment(initial_regulators(tap, 0.0 * tap), initial_banks(on))


def advanced(scenario: Scenario, before: Equipment, devices: Sequence[Any]) -> Equipment:
    """The equipment over the step whose devices have the given states, from what it measured at the beginning."""
    (regulators, banks), dt_s = before, scenario.dt_s
    of_regulators, of_banks = _plan(scenario, regulators.tap)
    regulators = control_taps(of_regulators.settings, regulators, dt_s, of_regulators.controlled)
    if of_regulators.agents is not None:
        device_state = devices[of_regulators.agents]
        tap, since, moved = (
            _picked(of_regulators, regulators, device_state, name) for name in ("tap", "since_s", "moved")
        )
        moves = before.regulators.moves + moved
        regulators = regulators._replace(tap=tap, since_s=since, moved=moved, moves=moves)
    if of_banks.acts:
        banks = control_banks(scenario.grid_control.capacitor_settings, banks, dt_s, of_banks.controlled)
    if of_banks.agents is not None:
        device_state = devices[of_banks.agents]
        on, since, switched = (_picked(of_banks, banks, device_state, name) for name in ("on", "since_s", "switched"))
        switchings = before.banks.switchings + switched
        banks = banks._replace(on=on, since_s=since, switched=switched, switchings=switchings)
    return Equipment(regulators, banks)


def measured(scenario: Scenario, equipment: Equipment, solution: ThreePhaseSolution) -> Equipment:
    """The equipment with what it measures in a power flow; banks measure where a control goes by it."""
    plan, banks = _plan(scenario, solution.v_pu), equipment.banks
    regulators = equipment.regulators._replace(relay_v=relay_volts(plan.regulators.settings, solution))
    return Equipment(regulators, measured_banks(plan.banks.settings, solution, banks) if plan.banks.acts else banks)


def with_relays(scenario: Scenario, devices: tuple[Any, ...], equipment: Equipment) -> tuple[Any, ...]:
    """The states of the devices, with what the relays of regulators that are agents measure."""
    position = _plan(scenario, equipment.regulators.relay_v).regulators.agents
    if position is None:
        return devices
    agents: Any = scenario.devices[position]
    relay_v = equipment.regulators.relay_v[..., list(agents.rows)]
    return (*devices[:position], devices[position]._replace(relay_v=relay_v), *devices[position + 1 :])


def as_control(scenario: Scenario, equipment: Equipment, connected: Array | None) -> Control:
    """Return the equipment as a control of the power flow; ``connected`` banks are as in ``begun``."""
    on = equipment.banks.on
    ratio = _feeder(scenario).tap_ratio(equipment.regulators.tap)
    return Control(ratio, None, on if connected is None else on * connected)


def _picked(group: _Group, state: object, commanded: object, name: str) -> Array:
    """A figure of all pieces, that of the agents out of the state of their group."""
    both = (getattr(state, name), getattr(commanded, name))
    return take_last(namespace(both[0]).concat(both, axis=-1), group.pick)


def _plan(scenario: Scenario, like: Array) -> _Plan:
    """The plan as arrays of the kind, precision and device of ``like``; made once for each."""
    if isinstance(like, np.ndarray) and like.dtype == np.float64:
        return _on_numpy(scenario)
    return _made(scenario, namespace(like), like.dtype, like.device)


@cached_on_owner
def _on_numpy(scenario: Scenario) -> _Plan:
    like = np.empty(0)
    return _made(scenario, np, like.dtype, like.device)


@cached_on_owner
def _made(scenario: Scenario, xp: ModuleType, dtype: object, device: object) -> _Plan:
    feeder, like = _feeder(scenario), xp.zeros(0, dtype=dtype, device=device)
    kinds = [kind.kind for kind in scenario.devices]
    groups: list[_Group] = []
    for settings, deciders, kind in (
        (relay_settings(feeder), regulator_deciders, TapChangers),
        (bank_settings(feeder), capacitor_deciders, CapacitorBanks),
    ):
        decides = deciders(scenario.grid_control, feeder)
        controlled = np.array([decider == "controlled" for decider in decides], np.float64)
        position = kinds.index(kind.kind) if kind.kind in kinds else None
        pick = np.arange(len(decides))
        if position is not None:
            agents: Any = scenario.devices[position]
            pick[list(agents.rows)] = len(decides) + np.arange(agents.count)
        settings, acts = settings_like(settings, like), bool(controlled.any())
        groups.append(_Group(settings, _like(controlled, like), acts, position, xp.asarray(pick, device=device)))
    return _Plan(*groups)


def _feeder(scenario: Scenario) -> Any:
    """The scenario's feeder, which has three phases."""
    return scenario.feeder


def _like(values: Array, like: Array) -> Array:
    return namespace(like).asarray(np.array(values, np.float64), dtype=like.dtype, device=like.device)

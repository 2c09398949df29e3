"""State before and after a step, and its exogenous inputs; arrays over environments, slots and buses."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from dcgrid_env.core.arrays import Array, namespace
from dcgrid_env.devices.capacitor_bank.bank_switching import BankState
from dcgrid_env.devices.ride_through.connection_surrogate import TripWidths
from dcgrid_env.devices.tap_changer.regulator_state import RegulatorState
from dcgrid_env.devices.tap_changer.regulator_view import RegulatorView


class LoadsToDraw(NamedTuple):
    """Inputs of ``loads.drawn``, which draws the other loads of an interval."""

    key: np.ndarray
    """(row,) uint64."""
    step: np.ndarray
    """(row,) int64."""
    noise: Array
    """The AR(1) process one step earlier, (row, n_bus)."""
    share: np.ndarray
    """Share of the peak at the environment's time of day, (row,); 1 with load profiles, which include it."""
    p_kw: np.ndarray | None = None
    """Active power of the loads before noise, kW, (row, n_leg), in a scenario with load profiles; None without."""
    q_kvar: np.ndarray | None = None
    """Reactive power of the loads before noise, kvar, likewise."""


class Exogenous(NamedTuple):
    """Exogenous inputs over one interval, which do not depend on an action."""

    p_load_kw: Array
    """Other loads, kW, (row, n_leg); a balanced feeder has a leg a bus."""
    q_load_kvar: Array
    """Other loads, kvar, (row, n_leg); on a balanced feeder less capacitors."""
    p_ref_kw: Array
    """Draw of sites at the highest clock with an empty queue, kW, (row, n_site)."""
    p_inverter_kw: Array
    """Scheduled active injection, kW, (row, slot) of the device that has a schedule."""
    nodes: Array
    """Nodes of each agent, flat positions row * n_node + node, int, (row, n_agent, k). An agent sees the
    mean voltage of its nodes and its power is shared equally among them; a balanced feeder has one node an agent."""
    compute_share: Array | None = None
    """Compute-bound share of the work that arrives, (row, n_site); None under a clock law of one work class."""
    available: Array | None = None
    """1 for an agent that is connected to the grid and 0 for one that is not, (row, n_agent); None where all are."""
    legs: Array | None = None
    """Legs of each agent, flat positions row * n_leg + leg, int, (row, n_agent, k); None: the nodes."""
    capacitor_on: Array | None = None
    """1 for a capacitor bank that can be on and 0 for one that is lost or disconnected, (row, n_capacitor); None where
    all can. (row, n_bus) on a balanced feeder, and None once ``q_load_kvar`` has them."""
    sags: Array | None = None
    """Sags that begin in the interval, (row, n_sag, 3), see ``connection.Supply``; None where a scenario has none."""
    trip_widths: TripWidths | None = None
    """Widths of the surrogate that gives tensors a derivative of what trips and returns; None for no derivative."""
    to_draw: LoadsToDraw | None = None
    """Inputs of loads that are not drawn yet, which are None then; None once they are drawn."""
    offset_v: Array | None = None
    """Offsets of regulators' set points by schedules, V, (row, n_regulator); None where a scenario has none."""
    request: Array | None = None
    """The utility's request over the interval and what is announced at its end, ``load_requests.RequestColumns``,
    (row, n_column); None where a scenario has none."""


class VoltageFigures(NamedTuple):
    """Figures over the nodes other than the substation's, (row,) each, p.u."""

    deviation_pu: np.ndarray
    """Sum of |V - 1|."""
    excess_pu: np.ndarray
    """Sum of what of it lies beyond the band."""
    lowest_pu: np.ndarray
    highest_pu: np.ndarray


class GridStep(NamedTuple):
    """What the grid did over an interval."""

    solution: Any
    """The power flow at its end."""
    noise: Array = None
    """The load noise at its end, (row, n_bus); None where the loads were drawn before."""
    figures: VoltageFigures | None = None
    """Figures of the solution's voltages, where the solver has them."""


class Equipment(NamedTuple):
    """All equipment of the feeder, in any mode of control."""

    regulators: RegulatorState
    banks: BankState


class ThreePhaseState(NamedTuple):
    """Additional state of a three-phase feeder."""

    v_re_pu: Array
    """Real part of the voltage, p.u., (row, n_node)."""
    v_im_pu: Array
    """Imaginary part of the voltage, p.u., (row, n_node)."""
    v_agent_lowest_pu: Array
    """Voltage of each agent's lowest phase, p.u., (row, n_agent)."""
    v_agent_highest_pu: Array
    """Voltage of its highest."""
    unbalance: Array
    """Voltage unbalance factor |V2| / |V1| of each three-phase bus, (row, n_three_phase_bus)."""
    equipment: Any
    """Regulators and capacitor banks, ``Equipment``; None before t = 0."""


class State(NamedTuple):
    """The state after a step; every array has the environments as its leading dimension, agents are ordered by device.

    A field of a device's state is read by its name too: ``state.backlog_kws``.
    """

    v_pu: Array
    """Voltage, p.u., (row, n_node); the last solved one where the power flow has none."""
    v_last_pu: Array
    """Voltage one step earlier."""
    v_agent_pu: Array
    """Voltage at the agents, p.u., (row, n_agent)."""
    v_agent_last_pu: Array
    restart: Array
    """Where the power flow starts next, ``Solution.restart`` of the last solved one; None before the first."""
    p_kw: Array
    """Draw from the grid, kW (an inverter's injection is negative), (row, n_agent); 0 where disconnected."""
    q_kvar: Array
    """Reactive injection as dispatched, kvar, (row, n_agent)."""
    q_limit_kvar: Array
    """Largest reactive magnitude at this active power, kvar, (row, n_agent)."""
    devices: tuple[Any, ...]
    """State of each of the scenario's devices, a NamedTuple of arrays (row, slot, ..)."""
    three_phase: ThreePhaseState | None = None
    """None on a balanced feeder."""
    p_window_kw: tuple[Array, ...] | None = None
    """``p_kw`` of the steps before, the beginning of the ramp limit's window first; None where no ramp is charged."""
    loading: Array | None = None
    """Current of the branch that feeds each node as a share of its rating, (row, n_node), 0 where that is not known;
    None for a feeder without ratings. The branches that close loops follow behind the nodes."""
    regulator_views: tuple[RegulatorView, ...] | None = None
    """What is reported of the feeder's regulators, the report that agents observe now first, and the last step's
    last; None where agents do not observe them."""
    request: Array | None = None
    """``Exogenous.request`` of the interval, which is charged and observed."""

    def __getattr__(self, name: str) -> Any:
        return device_field(self.devices, name)

    def map(self, function: Callable[[Array], Array]) -> State:
        """The state with every array put through a function."""
        return over_arrays(function, self)


def over_arrays(function: Callable[..., Array], first: Any, *others: Any) -> Any:
    """Return a state, or part of one, with each array replaced by a function of it and of the other states' arrays.

    None remains None, and an array for which another state has None is unchanged.
    """
    if first is None or any(other is None for other in others):
        return first
    if not isinstance(first, tuple):
        return function(first, *others)
    parts = [over_arrays(function, *same) for same in zip(first, *others, strict=True)]
    return type(first)(*parts) if hasattr(first, "_fields") else tuple(parts)


def device_field(devices: tuple[Any, ...], name: str) -> Any:
    """The field of this name of the devices that have it, one after the other along the slots; else AttributeError."""
    parts = [getattr(device, name) for device in devices if name in getattr(device, "_fields", ())]
    if not parts:
        raise AttributeError(f"no device has a field {name!r}")
    return parts[0] if len(parts) == 1 else namespace(parts[0]).concat(parts, axis=1)

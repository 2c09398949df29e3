"""Built-in control of a capacitor bank: switches by the voltage or the reactive power at its bus, with a delay.

    voltage: on below ``on_below_pu``, off above ``off_above_pu``, the mean of the bank's phases
    kvar: on above ``on_above_share``, off below ``off_below_share``, what the branch brings to the bank's phases of
    its bus, what the bank injects subtracted, as a share of the bank's rating

A threshold must be passed for ``delay_s`` without a break. ``bank_delays`` and ``next_switchings`` lead from one event
to the next within a step, as ``timed_taps`` does for regulators.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from math import lcm
from typing import Literal, NamedTuple

import numpy as np

from dcgrid_env.core.arrays import Array, namespace, take_last
from dcgrid_env.core.cache import cached_on_owner
from dcgrid_env.core.checked import check_fields, choice, number, refuse, settle
from dcgrid_env.devices.set_points import SHORTEST_HOLD_S
from dcgrid_env.grid import ThreePhaseFeeder
from dcgrid_env.powerflow.unbalanced.three_phase_solution import ThreePhaseSolution

_SAME_TIME_S = 1e-6


@dataclass(frozen=True, kw_only=True)
class CapacitorControl:
    """Switching rule of a controlled bank.

    The defaults of the reactive control are those of the IEEE 8500 node feeder: of 300 kvar a phase, on above 150 kvar
    and off below -225, after 100 s.
    """

    measures: Literal["voltage", "kvar"] = choice("voltage", "kvar", default="voltage")
    """Quantity that the control uses."""
    on_below_pu: float = number(0.5, 1.5, default=0.98)
    """Voltage below which it is switched on, p.u."""
    off_above_pu: float = number(0.5, 1.5, default=1.04)
    """Voltage above which it is switched off, p.u.; above ``on_below_pu``."""
    on_above_share: float = number(-10.0, 10.0, default=0.5)
    """Reactive power into its bus above which it is switched on, as a share of its rating."""
    off_below_share: float = number(-10.0, 10.0, default=-0.75)
    """Reactive power below which it is switched off; more than 1 below ``on_above_share``, as the bank itself brings
    it down by 1."""
    delay_s: float = number(0.0, 86_400.0, default=100.0)
    """Time for which a threshold is passed before it switches, s."""
    hold_s: float = number(SHORTEST_HOLD_S, 86_400.0, default=60.0)
    """Least time between changes of the thresholds by an agent (mode ``"setpoint"``), s."""

    def __post_init__(self) -> None:
        settle(self)
        check_fields(self)
        if self.off_above_pu <= self.on_below_pu:
            raise refuse(self, "off_above_pu", f"give more than on_below_pu = {self.on_below_pu:g}")
        if self.off_below_share >= self.on_above_share - 1.0:
            highest = self.on_above_share - 1.0
            raise refuse(self, "off_below_share", f"give less than on_above_share - 1 = {highest:g}, or it never rests")


class Thresholds(NamedTuple):
    """Thresholds of the voltage control that are in force in each environment, p.u., (row, n_capacitor) each."""

    on_below_pu: Array
    off_above_pu: Array


class BankSettings(NamedTuple):
    """Nodes and settings of a feeder's banks, in the order of their table."""

    nodes: Array
    """Nodes of each bank, a bank of fewer with each of them several times, int, (k n_capacitor,)."""
    kvar_per_pu_a: Array
    """Kvar of 1 p.u. of voltage and 1 A in quadrature in all phases of each bank, as a share of its rating,
    (n_capacitor,)."""


class BankState(NamedTuple):
    """Capacitor banks of a feeder in the order of their table, (row, n_capacitor) each."""

    on: Array
    """1 for a bank that is on and 0 for one that is off."""
    v_pu: Array
    """Mean voltage of its phases, p.u., as last measured."""
    kvar_share: Array
    """Reactive power that its branch brings to them, as a share of its rating, as last measured."""
    beyond_s: Array
    """Time for which a threshold has been passed, s."""
    since_s: Array
    """Time since it was last switched, or since t = 0, s."""
    switched: Array
    """1 where it was switched in the last step, else 0."""
    switchings: Array
    """Switchings since t = 0."""


@cached_on_owner
def bank_settings(feeder: ThreePhaseFeeder) -> BankSettings:
    """The settings of a feeder's banks, NumPy arrays."""
    legs, table = feeder.capacitor_legs, feeder.network.capacitor
    ends = [(legs.node[legs.row == row], legs.other[legs.row == row]) for row in range(len(table))]
    nodes = [np.unique(np.concatenate(of_bank)) for of_bank in ends]
    nodes = [of_bank[of_bank >= 0] for of_bank in nodes]
    nodes = [of_bank if len(of_bank) else np.zeros(1, np.int64) for of_bank in nodes]  # a bank of no kvar
    k = lcm(*map(len, nodes))
    rated = np.array([sum(kvar) for kvar in table.kvar], np.float64)
    base_kv = np.array([feeder.base_kv_ln[feeder.node_bus[of_bank[0]]] for of_bank in nodes], np.float64)
    tiled = [np.tile(of_bank, k // len(of_bank)) for of_bank in nodes]
    positions = np.array(tiled, np.int64).reshape(-1)
    phases = np.array([float(len(of_bank)) for of_bank in nodes])
    return BankSettings(positions, np.divide(base_kv * phases, rated, out=np.zeros_like(rated), where=rated > 0.0))


def measured_banks(settings: BankSettings, solution: ThreePhaseSolution, state: BankState) -> BankState:
    """The state with what each bank measures of a ``ThreePhaseSolution``."""
    shape = (*state.on.shape, -1)
    if not state.on.shape[-1]:
        return state
    of_nodes = (solution.v_pu, solution.v_re_pu, solution.v_im_pu, solution.i_re_a, solution.i_im_a)
    v, re, im, i_re, i_im = (take_last(values, settings.nodes).reshape(shape) for values in of_nodes)
    kvar = im * i_re - re * i_im
    k = v.shape[-1]
    return state._replace(v_pu=v.sum(-1) / k, kvar_share=kvar.sum(-1) / k * settings.kvar_per_pu_a)


def initial_banks(on: Array) -> BankState:
    """The state at t = 0 of banks that are on or off, (row, n_capacitor), before anything is measured."""
    zero = 0.0 * on
    return BankState(on, zero + 1.0, zero, zero, zero, zero, zero)


def bank_delays(
    control: CapacitorControl, state: BankState, controlled: Array | None = None, thresholds: Thresholds | None = None
) -> Array:
    """Time until each bank switches if its measurements stay, s, (row, n_capacitor); infinite within the thresholds.

    ``thresholds`` replace those of a voltage control; None for the same of all banks.
    """
    xp, zero = namespace(state.on), 0.0 * state.on
    left = control.delay_s - state.beyond_s
    beyond = _beyond(control, state, controlled, thresholds)
    return xp.where(beyond, xp.where(left > 0.0, left, zero), zero + math.inf)


def next_switchings(state: BankState, delay_s: Array, passed_s: Array, acts: Array) -> BankState:
    """Let time pass until the next event, and switch the banks whose delay ends then.

    Parameters
    ----------
    state
        The banks, with what they measure now.
    delay_s
        Their delays by ``bank_delays``, s, (row, n_capacitor).
    passed_s
        Time until the event, s, (row, 1).
    acts
        Whether the event is before the end of the step, bool, (row, 1). Otherwise nothing is switched.
    """
    xp, zero = namespace(state.on), 0.0 * state.on
    due = acts & (delay_s <= passed_s + _SAME_TIME_S)
    switched = xp.where(due, zero + 1.0, zero)
    return state._replace(
        on=xp.where(due, 1.0 - state.on, state.on),
        beyond_s=xp.where(due | (delay_s == math.inf), zero, state.beyond_s + passed_s),
        since_s=xp.where(due, zero, state.since_s + passed_s),
        switched=state.switched + switched,
        switchings=state.switchings + switched,
    )


def _beyond(
    control: CapacitorControl, state: BankState, controlled: Array | None, thresholds: Thresholds | None = None
) -> Array:
    """Whether each bank's measurement is beyond the threshold at which it switches, bool, (row, n_capacitor)."""
    if control.measures == "voltage":
        limits = control if thresholds is None else thresholds
        too_low, too_high = state.v_pu < limits.on_below_pu, state.v_pu > limits.off_above_pu
    else:
        too_low, too_high = state.kvar_share > control.on_above_share, state.kvar_share < control.off_below_share
    beyond = (too_low & (state.on < 0.5)) | (too_high & (state.on > 0.5))
    return beyond if controlled is None else beyond & (controlled > 0.0)

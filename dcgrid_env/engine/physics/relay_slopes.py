"""Changes of relay volts and voltages by powers and taps: differences of power flows around the base load."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from dcgrid_env.engine.physics.acting_relays import ActingRelays
from dcgrid_env.powerflow import Control, solver_for
from dcgrid_env.scenario.scenario import Scenario


class RelaySlopes(NamedTuple):
    """What k changes of powers and R taps move."""

    by_p: np.ndarray
    """Change of relay volts where the powers are drawn as active power, (k, R)."""
    by_q: np.ndarray
    """Change of relay volts where they are injected as reactive power, (k, R)."""
    by_tap: np.ndarray
    """Volts of the column relay per tap of the row regulator, (R, R)."""
    v_by_tap: np.ndarray
    """Voltage of each node but the substation's per tap, p.u., (R, n_load_node)."""


def relay_slopes(scenario: Scenario, relays: ActingRelays, moved: np.ndarray) -> RelaySlopes:
    """Return the changes at the base load and base taps.

    Parameters
    ----------
    scenario, relays
        A scenario on a three-phase feeder, and relays of its regulators.
    moved
        Changes of powers, kW drawn and in turn kvar injected, (k, n_leg).
    """
    feeder: Any = scenario.feeder
    zeros, step = 0.0 * moved, np.eye(len(feeder.base_tap))[relays.rows]
    still = np.zeros((1 + len(step), feeder.n_leg))
    p_kw, q_kvar = (
        load + np.concatenate((still, *changes))
        for load, changes in ((feeder.p_load_kw, (moved, zeros)), (feeder.q_load_kvar, (zeros, -moved)))
    )
    taps = np.tile(feeder.base_tap, (len(p_kw), 1))
    taps[1 : 1 + len(step)] += step
    on = scenario.capacitor_connected
    on = None if on is None else np.broadcast_to(on, (len(p_kw), *np.shape(on)))
    solve = solver_for(feeder, scenario.power_flow)
    solution: Any = solve(feeder, p_kw, q_kvar, scenario.source_voltage_pu, Control(feeder.tap_ratio(taps), None, on))
    volts = relays.volts(solution)
    by_tap, by_p, by_q = np.split(volts[1:] - volts[0], [len(step), len(step) + len(moved)])
    v_pu = solution.v_pu[..., feeder.load_slice]
    return RelaySlopes(by_p, by_q, by_tap, v_pu[1 : 1 + len(step)] - v_pu[0])

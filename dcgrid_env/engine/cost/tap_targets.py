"""Taps that lower the voltage cost once the agents choose their reactive power for them.

At fixed powers a tap rarely helps, because the set points fit the feeder. A tap down is useful where the agents then
raise voltages from far away and so level the profile. The saving is therefore that of the least cost over all reactive
powers,

    c(taps) = min over q of w mean max(|V + dV/dtap taps + dV/dq (q - q0) - target| - uncharged, 0),  |q| <= limit,

a linear program, as a mean over episodes at t = 0, where taps have settled without reactive power. Taps are added one
after the other, the best first, while one saves its price over an episode. At most one tap of each regulator is added,
and only if it is possible in all these episodes. The saving of a tap is the increase of c without it at the taps that
were found, so it counts what the others bring.
"""

from __future__ import annotations

import numpy as np

from dcgrid_env.engine.cost.difference import charges, sensitivities
from dcgrid_env.engine.cost.tap_credit import TapTargets
from dcgrid_env.engine.physics.acting_relays import ActingRelays
from dcgrid_env.engine.physics.connections import connections
from dcgrid_env.engine.physics.relay_slopes import relay_slopes
from dcgrid_env.engine.physics.state import State
from dcgrid_env.scenario.costs.equipment_moves import price_of_move
from dcgrid_env.scenario.scenario import Scenario

LEAST = 1e-3
"""Smallest saving of a useful tap as a share of the voltage cost."""
_SPAN = 10.0  # kW and kvar by which the power of a node is moved to find a slope


def useful_taps(scenario: Scenario, relays: ActingRelays, state: State, buses: np.ndarray) -> TapTargets | None:
    """Return the useful taps of some regulators, or None without any.

    Parameters
    ----------
    scenario
        A scenario whose voltage cost has the form l1.
    relays
        The regulators that may tap.
    state, buses
        States of sampled episodes at t = 0, and the positions of the agents' buses there, (row, n_agent).
    """
    feeder = scenario.feeder
    moved = np.zeros((feeder.n_node, feeder.n_leg))
    moved[np.arange(feeder.n_node), feeder.first_device_leg + np.arange(feeder.n_node)] = _SPAN
    slopes = relay_slopes(scenario, relays, moved)
    groups = connections(scenario)
    by_q = sensitivities(scenario).by_q[groups.group[np.arange(scenario.n_agents), buses]]
    taps, now = np.zeros(len(relays.rows)), _least_cost(scenario, state, by_q, 0.0 * slopes.v_by_tap[0])
    price, least, one = price_of_move(scenario), LEAST * now, np.eye(len(taps))
    tap, settings, rows = state.three_phase.equipment.regulators.tap, relays.settings, relays.rows  # pyright: ignore[reportOptionalMemberAccess]
    possible = {
        sign: ((tap + sign <= settings.highest) & (tap + sign >= settings.lowest)).all(0)[rows] for sign in (-1.0, 1.0)
    }

    def cost(some: np.ndarray) -> float:
        return _least_cost(scenario, state, by_q, some @ slopes.v_by_tap)

    while len(free := np.flatnonzero(taps == 0.0)):
        options = [taps + sign * one[relay] for relay in free for sign in possible if possible[sign][relay]]
        if not options:
            break
        costs = list(map(cost, options))
        best = int(np.argmin(costs))
        if now - costs[best] < least or (now - costs[best]) * scenario.horizon <= price:
            break
        taps, now = options[best], costs[best]
    useful = np.flatnonzero(taps)
    if not len(useful):
        return None
    saving = np.array([cost(taps - taps * one[relay]) for relay in useful]) - now
    # Per kW and kvar injected; slopes are by the draw of kW. A tap up is useful at low volts.
    off_v = (
        np.ascontiguousarray(-taps[useful] * by[groups.nodes][..., useful].mean(1) / _SPAN)
        for by in (-slopes.by_p, slopes.by_q)
    )
    return TapTargets(relays.rows[useful], taps[useful], saving, price, *off_v)


def _least_cost(scenario: Scenario, state: State, by_q: np.ndarray, moved_pu: np.ndarray) -> float:
    """Return the mean over rows of the least voltage cost with voltages moved by ``moved_pu`` (n_charged,).

    ``by_q`` are slopes of the charged voltages by the agents' reactive power, p.u. per kvar, (row, n_agent, n_charged).
    """
    from scipy.optimize import linprog  # slow to import, and not needed by a step
    from scipy.sparse import csc_matrix, eye, hstack

    charged, uncharged = charges(scenario), scenario.cost.uncharged_pu
    n_agent, n = by_q.shape[1:]
    price = np.concatenate((np.zeros(n_agent), np.full(2 * n, charged.voltage), np.zeros(n)))
    of_nodes = np.repeat([[0.0, np.inf], [-uncharged, uncharged]], [2 * n, n], axis=0)
    total = 0.0
    for v_pu, q, limit, slopes in zip(state.v_pu, state.q_kvar, state.q_limit_kvar, by_q, strict=True):
        off = charged.targets_pu - v_pu[scenario.feeder.load_slice] - moved_pu
        rows = hstack((csc_matrix(slopes.T), -eye(n), eye(n), eye(n)))
        bounds = np.concatenate((np.stack((-limit - q, limit - q), axis=-1), of_nodes))
        total += linprog(price, A_eq=rows, b_eq=off, bounds=bounds).fun
    return total / len(by_q)

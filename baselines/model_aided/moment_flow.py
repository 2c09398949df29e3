"""The exact power flow of the moments, for one placement.

If the model of a scenario is not exact, agents know the size of the error and not its sign. Resistances and reactances
are then larger or smaller by this share, each of the four combinations at a quarter of the moments.

The taps of regulators that act have settled without reactive power, as at the beginning of an episode. If delays are
longer than a step, the taps have then settled under the set points too. The effect of a set point therefore includes
the taps that it causes. If delays end within a step, taps answer each decision, which constant set points do not model.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from dcgrid_env import Control, Feeder, acting_relays, nodes_by_bus, solver_for
from dcgrid_env.baselines.model_aided.knowledge import Site


class MomentFlow:
    """The feeder as agents know it, at the moments of a site, with agents at positions ``buses`` of ``bus_ids``."""

    def __init__(self, site: Site, buses: np.ndarray) -> None:
        s = self.scenario = site.scenario
        self.points, self.feeder = site.points, s.model
        wrong_r, wrong_x = abs(1.0 - s.sensing.r_model_share), abs(1.0 - s.sensing.x_model_share)
        signs = ((1, 1), (1, -1), (-1, 1), (-1, -1)) if wrong_r or wrong_x else ()
        self.feeders = [s.model.scaled(1 + a * wrong_r, 1 + b * wrong_x) for a, b in signs] or [self.feeder]
        nodes = nodes_by_bus(s)[np.arange(s.n_agents), buses]
        self.shares = np.zeros((s.n_agents, self.feeder.n_leg))
        rows = np.arange(s.n_agents)[:, None]
        np.add.at(self.shares, (rows, self.feeder.first_device_leg + nodes), 1.0 / nodes.shape[1])
        observed = np.zeros((s.n_agents, self.feeder.n_node))
        np.add.at(observed, (rows, nodes), 1.0 / nodes.shape[1])
        self.observed_share = observed[:, self.feeder.load_slice]
        """Share of each voltage in what an agent sees, (n_agent, k)."""
        is_balanced = isinstance(s.feeder, Feeder)
        self._position = s.model_position if is_balanced else np.arange(self.feeder.n_node)
        self._order = np.argsort(self._position) if is_balanced else np.arange(self.feeder.n_leg)
        self._relays = acting_relays(s)
        self._first_tap = np.zeros((len(self.points.p_load_kw), 0))
        if self._relays is not None:
            p_kw, n = self.points.p_load_kw + self.points.p_agent_kw @ self.shares, len(self.feeders)
            self._first_tap = np.empty((len(p_kw), len(self._relays.settings.target_v)))
            for k, feeder in enumerate(self.feeders):
                self._first_tap[k::n] = self._relays.settled(
                    feeder, p_kw[k::n], self.points.q_load_kvar[k::n], s.source_voltage_pu
                )

    def at_moments(self, rows: np.ndarray) -> Callable[[np.ndarray], np.ndarray]:
        """Voltages of some moments as a function of constant setpoints, kvar, (n_agent,)."""
        return lambda q_kvar: self.voltages(np.broadcast_to(q_kvar, (len(rows), len(q_kvar))), rows)

    def voltages(self, q_kvar: np.ndarray, rows: np.ndarray | slice = slice(None)) -> np.ndarray:
        """Voltages of moments under setpoints, (m, n_agent), p.u., (m, k); the mean where no solution exists."""
        s, points = self.scenario, self.points
        p = points.p_load_kw[rows] + points.p_agent_kw[rows] @ self.shares
        q = points.q_load_kvar[rows] - q_kvar @ self.shares
        p, q = p[:, self._order], q[:, self._order]
        feeder_index = np.arange(len(points.p_load_kw))[rows] % len(self.feeders)
        first_tap = self._first_tap[rows]
        v, solved = np.empty((len(p), self.observed_share.shape[1])), np.empty(len(p), bool)
        for k, feeder in enumerate(self.feeders):
            of_feeder = feeder_index == k
            load, control = (feeder, p[of_feeder], q[of_feeder], s.source_voltage_pu), None
            if self._relays is not None:
                tap = first_tap[of_feeder]
                tap = self._relays.settled(*load, tap) if (self._relays.steps > 1).all() else tap
                control = Control(feeder.tap_ratio(tap))
            solution = solver_for(feeder, s.power_flow)(*load, control)
            v_pu = np.asarray(solution.v_pu)[:, self._position]
            v[of_feeder], solved[of_feeder] = v_pu[:, feeder.load_slice], solution.converged
        if not solved.any():
            raise ValueError(
                f"model-aided: the power flow of scenario {s.name!r} has no solution at any of its moments; give the "
                "feeder less load"
            )
        return np.where(solved[:, None], v, v[solved].mean(axis=0))

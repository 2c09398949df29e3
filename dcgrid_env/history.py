"""What the picture remembers of the running episode."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from dcgrid_env import episode
from dcgrid_env.scenario import Scenario

if TYPE_CHECKING:
    from dcgrid_env.simulation import Snapshot


class History:
    """Lane 0 of the running episode, one row a step, in arrays that are made once; float32 is plenty for a picture."""

    def __init__(self, scenario: Scenario):
        rows, n_dc = scenario.horizon + 1, scenario.n_datacenters
        self.v_pu = np.empty((rows, scenario.feeder.n_bus), np.float32)
        self.f_mhz = np.empty((rows, n_dc), np.float32)
        self.backlog_kws = np.empty((rows, n_dc), np.float32)
        self.p_kw = np.empty((rows, scenario.n_agents), np.float32)
        self.q_kvar = np.empty((rows, scenario.n_agents), np.float32)
        self.first = self.last = -1
        self.key: Any = None
        self.episode: Any = None
        self.solved = True

    def add(self, snapshot: Snapshot) -> None:
        """Copy lane 0: it is small, while a reference would keep the arrays of every lane alive."""
        step, state, drawn = int(snapshot.step[0]), snapshot.state, snapshot.episode
        # A restored environment may go on from any step, of this episode or another.
        if step == 0 or drawn.key[0] != self.key or not self.first <= step <= self.last + 1:
            self.first, self.key, self.episode = step, drawn.key[0], drawn
        self.last = step
        self.v_pu[step] = state.v_pu[0]
        self.f_mhz[step] = state.f_mhz[0]
        self.backlog_kws[step] = state.backlog_kws[0]
        self.p_kw[step] = state.p_kw[0]
        self.q_kvar[step] = state.q_kvar[0]
        self.solved = snapshot.transition.converged[0]

    @property
    def buses(self) -> np.ndarray:
        """Position of each agent's bus, (n_agent,)."""
        return self.episode.buses[0]

    def p_ref_kw(self, scenario: Scenario, steps: np.ndarray) -> np.ndarray:
        """What was asked for in the intervals that end at ``steps``, kW, (n_step, n_dc)."""
        return episode.p_ref_kw(scenario, self.episode._replace(start=self.episode.start[:1]), steps)

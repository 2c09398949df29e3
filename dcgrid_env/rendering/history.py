"""What the picture remembers of the running episode."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from dcgrid_env.engine import episode
from dcgrid_env.grid import AnyFeeder
from dcgrid_env.scenario.scenario import Scenario

if TYPE_CHECKING:
    from dcgrid_env.engine.simulation import Snapshot


class History:
    """A lane's running episode, one row a step, in arrays that are made once; float32 is plenty for a picture."""

    def __init__(self, scenario: Scenario, lane: int = 0):
        self.lane = lane
        rows, n_dc = scenario.horizon + 1, scenario.n_sites
        self.order = sites_first(scenario)
        """Agents as the picture has them."""
        self.v_pu = np.empty((rows, scenario.feeder.n_node), np.float32)
        self._feeder = scenario.feeder
        self.f_mhz = np.empty((rows, n_dc), np.float32)
        self.backlog_kws = np.empty((rows, n_dc), np.float32)
        self.p_kw = np.empty((rows, scenario.n_agents), np.float32)
        self.q_kvar = np.empty((rows, scenario.n_agents), np.float32)
        self.first = self.last = -1
        self.key: Any = None
        self.episode: Any = None
        self.solved = True

    def add(self, snapshot: Snapshot) -> None:
        """Copy the lane: it is small, while a reference would keep the arrays of every lane alive."""
        lane, state, drawn = self.lane, snapshot.state, snapshot.episode
        step = int(snapshot.step[lane])
        # A restored environment may go on from any step, of this episode or another.
        if step == 0 or drawn.key[lane] != self.key or not self.first <= step <= self.last + 1:
            self.first, self.key, self.episode = step, drawn.key[lane], drawn
        self.last = step
        self.v_pu[step] = state.v_pu[lane]
        if self.f_mhz.shape[1]:
            self.f_mhz[step] = state.f_mhz[lane]
            self.backlog_kws[step] = state.backlog_kws[lane]
        self.p_kw[step] = state.p_kw[lane, self.order]
        self.q_kvar[step] = state.q_kvar[lane, self.order]
        self.solved = snapshot.transition.converged[lane]

    def bus_v_pu(self, steps: int | slice) -> np.ndarray:
        """Voltage of each bus, the mean of its phases, p.u., (..., n_bus)."""
        return bus_means(self._feeder, self.v_pu[steps])

    @property
    def buses(self) -> np.ndarray:
        """Position of each agent's bus, (n_agent,), in the picture's order."""
        return self.episode.buses[self.lane, self.order]

    def p_ref_kw(self, scenario: Scenario, steps: np.ndarray) -> np.ndarray:
        """What was asked for in the intervals that end at ``steps``, kW, (n_step, n_dc)."""
        return episode.p_ref_kw(scenario, self.episode._replace(start=self.episode.start[self.lane, None]), steps)


def bus_means(feeder: AnyFeeder, by_node: np.ndarray) -> np.ndarray:
    """Mean over the nodes of each bus, (..., n_bus) of (..., n_node)."""
    first = np.flatnonzero(np.diff(feeder.node_bus, prepend=-1))
    return np.add.reduceat(by_node, first, axis=-1) / np.bincount(feeder.node_bus).astype(by_node.dtype)


def node_words(feeder: AnyFeeder) -> tuple[str, str]:
    """What a picture calls one node of a feeder, and several: a balanced feeder's are its buses."""
    return ("bus", "buses") if feeder.n_node == feeder.n_bus else ("node", "nodes")


def sites_first(scenario: Scenario) -> np.ndarray:
    """Positions of the agents as a picture has them, sites of work before other devices, (n_agent,)."""
    is_site = [device.input == "workload" for device in scenario.devices for _ in range(device.count)]
    return np.argsort(np.logical_not(is_site), kind="stable")

"""What the picture remembers of the running episode."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from dcgrid_env.devices.grid_equipment import is_equipment
from dcgrid_env.engine.exogenous import episode
from dcgrid_env.grid import AnyFeeder, Feeder, ThreePhaseFeeder
from dcgrid_env.powerflow import three_phase_nodes
from dcgrid_env.scenario.scenario import Scenario

if TYPE_CHECKING:
    from dcgrid_env.engine.physics.state import ThreePhaseState
    from dcgrid_env.engine.record.episode_record import Series
    from dcgrid_env.engine.simulation import Snapshot


class History:
    """An environment's running episode, one row a step, in arrays made once; float32 is enough for a picture."""

    def __init__(self, scenario: Scenario, env_index: int = 0):
        self.env_index = env_index
        rows, n_dc = scenario.horizon + 1, scenario.n_sites
        self.order = sites_first(scenario)
        """Agents as the picture has them."""
        self.v_pu = np.empty((rows, scenario.feeder.n_node), np.float32)
        self.f_mhz = np.empty((rows, n_dc), np.float32)
        self.backlog_kws = np.empty((rows, n_dc), np.float32)
        self.p_kw = np.empty((rows, len(self.order)), np.float32)
        self.q_kvar = np.empty((rows, len(self.order)), np.float32)
        self.phases = PhaseHistory(scenario.feeder, rows) if isinstance(scenario.feeder, ThreePhaseFeeder) else None
        self.first = self.last = -1
        self.key: Any = None
        self.episode: Any = None
        self.solved = True

    @classmethod
    def from_series(cls, run: Series) -> History:
        """A whole episode as it was recorded; ``last`` says up to which step a picture shows it."""
        history, rows = cls(run.scenario), len(run.v_pu)
        history.v_pu[:rows] = run.v_pu
        if run.scenario.n_sites:
            states = [
                state
                for device, state in zip(run.scenario.devices, run.devices, strict=True)
                if device.input == "workload"
            ]
            history.f_mhz[:rows] = np.concatenate([state.f_mhz for state in states], axis=1)
            history.backlog_kws[:rows] = np.concatenate([state.backlog_kws for state in states], axis=1)
        history.p_kw[:rows] = run.p_kw_from_reset[:, history.order]
        history.q_kvar[0], history.q_kvar[1:rows] = 0.0, run.q_kvar[:, history.order]
        if history.phases is not None:
            history.phases.fill(run.three_phase, rows)
        drawn: Any = dict.fromkeys(episode.Episode._fields)
        drawn |= {"buses": run.buses[None], "start": run.trace_start[None], "fault": run.fault[None]}
        history.episode, history.first, history.last = episode.Episode(**drawn), 0, rows - 1
        history.solved = run.converged
        return history

    def add(self, snapshot: Snapshot) -> None:
        """Copy the state of one environment: a reference would keep the arrays of every environment alive."""
        env_index, state, drawn = self.env_index, snapshot.state, snapshot.episode
        step = int(snapshot.step[env_index])
        # A restored environment may go on from any step, of this episode or another.
        if step == 0 or drawn.key[env_index] != self.key or not self.first <= step <= self.last + 1:
            self.first, self.key, self.episode = step, drawn.key[env_index], drawn
        self.last = step
        self.v_pu[step] = state.v_pu[env_index]
        if self.f_mhz.shape[1]:
            self.f_mhz[step] = state.f_mhz[env_index]
            self.backlog_kws[step] = state.backlog_kws[env_index]
        self.p_kw[step] = state.p_kw[env_index, self.order]
        self.q_kvar[step] = state.q_kvar[env_index, self.order]
        if self.phases is not None and state.three_phase is not None:
            self.phases.add(state.three_phase, env_index, step)
        self.solved = snapshot.transition.converged[env_index]

    @property
    def buses(self) -> np.ndarray:
        """Position of each agent's bus, in the picture's order."""
        return self.episode.buses[self.env_index, self.order]

    def p_ref_kw(self, scenario: Scenario, steps: np.ndarray) -> np.ndarray:
        """What was asked for in the intervals that end at ``steps``, kW, (n_step, n_dc)."""
        return episode.p_ref_kw(scenario, self.episode._replace(start=self.episode.start[self.env_index, None]), steps)

    def lost_banks(self, scenario: Scenario) -> np.ndarray:
        """Which capacitor banks a fault has taken in the last step, bool, (n_capacitor,)."""
        if not scenario.faults:
            return np.zeros(len(scenario.capacitor_connected), bool)
        fault = self.episode.fault[self.env_index, None]
        return episode.lost(scenario, fault, np.array([self.last]))[0, scenario.n_agents :]


class PhaseHistory:
    """Additional figures of a three-phase feeder, one row per step."""

    def __init__(self, feeder: ThreePhaseFeeder, rows: int):
        self.unbalance = np.empty((rows, len(three_phase_nodes(feeder))), np.float32)
        """Voltage unbalance factor of each three-phase bus."""
        self.tap = np.empty((rows, feeder.n_regulator), np.float32)
        self.on = np.empty((rows, feeder.n_capacitor), np.float32)
        self.moves = np.empty((rows, 2), np.int64)
        """Taps and switchings made since t = 0."""

    def fill(self, over_time: ThreePhaseState, rows: int) -> None:
        """Take a whole episode's states, arrays with so many rows in front."""
        regulators, banks = over_time.equipment
        self.unbalance[:rows], self.tap[:rows], self.on[:rows] = over_time.unbalance, regulators.tap, banks.on
        self.moves[:rows] = np.column_stack((regulators.moves.sum(axis=1), banks.switchings.sum(axis=1)))

    def add(self, state: ThreePhaseState, env_index: int, step: int) -> None:
        """Copy an environment's state after a step."""
        regulators, banks = state.equipment
        self.unbalance[step] = state.unbalance[env_index]
        self.tap[step], self.on[step] = regulators.tap[env_index], banks.on[env_index]
        self.moves[step] = regulators.moves[env_index].sum(), banks.switchings[env_index].sum()


def node_words(feeder: AnyFeeder) -> tuple[str, str]:
    """Return the words for one node of a feeder and for several; the nodes of a balanced feeder are its buses."""
    return ("bus", "buses") if isinstance(feeder, Feeder) else ("node", "nodes")


def sites_first(scenario: Scenario) -> np.ndarray:
    """Positions of the agents that have a converter, sites of work before other devices, int, (n,).

    Agents that are equipment of the feeder are shown with the feeder, see ``equipment_labels``.
    """
    kinds = [device for device in scenario.devices for _ in range(device.count)]
    order = sorted(range(len(kinds)), key=lambda i: kinds[i].input != "workload")
    return np.array([i for i in order if not is_equipment(kinds[i])], dtype=np.intp)

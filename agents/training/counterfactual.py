"""Compute counterfactual advantages of each agent's action components with the grid model.

An advantage compares the team's cost of a step with its cost if one component of one agent's action had been the
policy's mean. It is a difference reward (D. Wolpert and K. Tumer, "Optimal payoff functions for members of
collectives", Advances in Complex Systems 4, 2001) with the mean action as the default. The baseline of J. Foerster et
al., "Counterfactual multi-agent policy gradients", arXiv 1705.08926, is similar. With c the cost of all voltages V,

    q      A = c(V - M (q - q')) - c(V) + effort(q') - effort(q)        M = dV / dq of the agent
    clock  A = c(V + R (p - p')) - c(V) + w (b' - b) / sum(p_rated)     R = dV / dp of the agent, injected

where q' is the converter's dispatch under the mean action. p' and b' are the demand and the backlog of the site under
the mean clock, computed by the device's step function.

Deferred work is charged immediately, at w = w_backlog + w_leftover for each second at full load. This is a bias: it
assumes the waiting time that is charged for leftover work at an episode's end. Other effects on later steps are
neglected, and so is the effect of a changed demand on the converter's limit.

Only training uses the grid model and all node voltages. The policy uses the agents' observations.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from dcgrid_env import (
    Feeder,
    RandomFeeders,
    Scenario,
    action_layout,
    beyond_band,
    cost_prices,
    sensitivity_to_agents,
    voltage_deviation,
)
from dcgrid_env.baselines.controller import require_known_devices
from dcgrid_env.devices import DataCenters, Work, work_classes_of


def require_one_step(who: str, scenario: Scenario) -> None:
    """Raise ValueError, with the field's name, unless the cost of a single step determines the advantages."""
    require_known_devices(who, scenario)
    if isinstance(scenario.feeder, RandomFeeders):
        raise ValueError(f"{who} needs the model of one feeder; {scenario.name!r} has random ones: train analytic")
    for device in scenario.devices:
        for field in ("storage", "smoothing", "routing", "batching", "service", "cooling", "ride_through"):
            if device.count and getattr(device, field, None) is not None:
                raise ValueError(
                    f"{who} judges an action by the step that it acts in; scenario {scenario.name!r} has {field} at "
                    f"its devices of kind {device.kind}, which acts on later steps: train analytic or ppo there"
                )
        if isinstance(device, DataCenters) and work_classes_of(device.clock_law) != 1:
            raise ValueError(f"{who} takes clock laws of one work class; scenario {scenario.name!r} has one of two")
    if scenario.cost.voltage != "l1":
        raise ValueError(f"{who}: cost.voltage is {scenario.cost.voltage!r}; make the scenario with 'l1'")
    for name in scenario.cost.weights.unmodelled:
        weight = getattr(scenario.cost.weights, name)
        raise ValueError(f"{who} does not know what weights.{name} = {weight:g} charges; set it to 0, or train ppo")


class Counterfactual:
    """Compute the advantages of the actions in a batch of rows.

    Parameters
    ----------
    scenario
        Scenario of the batch; it must pass ``require_one_step``.
    """

    def __init__(self, scenario: Scenario):
        require_one_step("a counterfactual advantage", scenario)
        self.scenario = scenario
        layout, self._prices = action_layout(scenario), cost_prices(scenario)
        self._is_clock, self._is_q = layout.is_channel("clock"), layout.is_channel("q")
        self._site: Any = scenario.datacenters
        self._buses = np.zeros((0, 0), np.int64)

    def of_step(self, before: Any, after: Any, action: np.ndarray, mean: np.ndarray) -> np.ndarray:
        """Return the advantage of each action entry in a step, (row, n_action): the decrease in team cost.

        Parameters
        ----------
        before
            Result of the batch's ``save()`` before the step.
        after
            State at the end of the step, before any new episode. If the power flow has no solution, the state contains
            the last solved voltages.
        action, mean
            Joint actions, (row, n_action): the action taken and the policy's mean.
        """
        self._place(before.episode.buses)
        advantages = np.empty(action.shape)
        clock = self._is_clock
        advantages[:, clock] = self._of_clock(before, after, action[:, clock], mean[:, clock])
        advantages[:, self._is_q] = self._of_q(after, mean[:, self._is_q])
        return advantages

    def _place(self, buses: np.ndarray) -> None:
        """Set the voltage sensitivities to each agent, p.u. per injected kW and kvar, (row, n_agent, n_node)."""
        if not np.array_equal(buses, self._buses):
            by_p, by_q = sensitivity_to_agents(self.scenario, buses)
            judged, n_dc = self.scenario.feeder.load_slice, self.scenario.datacenters.count
            self._by_p, self._by_q = by_p[:, :n_dc, judged] / 1e3, by_q[..., judged] / 1e3
            self._buses = buses

    def _of_q(self, after: Any, mean: np.ndarray) -> np.ndarray:
        limit = after.q_limit_kvar
        q_mean = np.clip(mean * self.scenario.q_scale_kvar, -limit, limit)
        effort = self._prices.effort * (np.abs(q_mean) - np.abs(after.q_kvar))
        return effort - self._saved(after, self._by_q, after.q_kvar - q_mean)

    def _of_clock(self, before: Any, after: Any, clock: np.ndarray, mean: np.ndarray) -> np.ndarray:
        site, dt_s = self._site, self.scenario.dt_s
        params, work = site.parameters, Work(before.p_ref_next_kw, None)
        (chosen, p_kw), (chosen_mean, p_mean) = (
            site.step(params, before.state.devices[0], (_mhz(params, each),), work, dt_s) for each in (clock, mean)
        )
        connected = (
            after.p_kw[:, : self.scenario.datacenters.count] > 0.0
        )  # a site that a fault has taken draws nothing
        waiting = (self._prices.backlog + self._prices.leftover) * (chosen_mean.backlog_kws - chosen.backlog_kws)
        return waiting - self._saved(after, self._by_p, (p_mean - p_kw) * connected)

    def _saved(self, after: Any, by: np.ndarray, injected: np.ndarray) -> np.ndarray:
        """Return the increase in voltage cost due to an injection of each agent, (row, agent)."""
        v = after.v_pu[:, None, self.scenario.feeder.load_slice]
        moved = by * injected[..., None]
        if isinstance(self.scenario.feeder, Feeder):
            moved = moved / v  # LinDistFlow is linear in the square of the voltage
        return self._cost(v) - self._cost(v - moved)

    def _cost(self, v_pu: np.ndarray) -> np.ndarray:
        """Return the cost of voltages, (..., n_node), summed over the nodes."""
        s = self.scenario
        deviation = voltage_deviation(s, v_pu, s.feeder.load_slice)
        beyond = beyond_band(v_pu - 1.0, s.cost.band_pu)
        return self._prices.voltage * deviation.sum(-1) + self._prices.violation * beyond.sum(-1)


def _mhz(params: Any, clock: np.ndarray) -> np.ndarray:
    """Return clock set points, MHz, for actions in [-1, 1]."""
    return params.f_min_mhz + 0.5 * (clock + 1.0) * (params.f_max_mhz - params.f_min_mhz)

"""Metrics of the grid over an episode: cost, voltages, losses, unbalance and moves of equipment."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from dcgrid_env.core.arrays import Array
from dcgrid_env.core.metric import Combined, Metric, cost_metric
from dcgrid_env.devices.grid_equipment import is_equipment
from dcgrid_env.engine.cost.fluctuation import StreamingFluctuation
from dcgrid_env.engine.physics.disconnection import disconnectable_devices
from dcgrid_env.grid import ThreePhaseFeeder
from dcgrid_env.powerflow import nema_unbalance, three_phase_nodes
from dcgrid_env.scenario.costs import load_requests, overload
from dcgrid_env.scenario.scenario import Scenario

VOLTAGES = (
    Metric("J", "J", "", 4, "lower", "cost of the episode; its terms ``cost_*`` add up to it", "sum",
        tables=("run", "evaluate", "check")),
    Metric("voltage_deviation_mean_pu", "mean |V-1|", "p.u.", 4, "lower",
        "mean abs(V - 1) of the nodes but the substation's, steps 1 .. T; a node is a bus or a phase of one", "mean",
        tables=("run", "evaluate", "benchmark", "check")),
    Metric("voltage_deviation_std_pu", "std of |V-1|", "p.u.", 4, "lower", "standard deviation of the same",
        tables=("run",)),
    Metric("outside_bus_seconds_pct", "bus-seconds outside", "%", 2, "lower",
        "share of those nodes and steps with a voltage outside the band", "mean",
        tables=("run", "evaluate", "benchmark", "check"), short="outside, % of bus-s"),
    Metric("outside_buses_pct", "buses ever outside", "%", 1, "lower",
        "share of those nodes that are ever outside the band", tables=("run",)),
    Metric("voltage_min_pu", "lowest voltage", "p.u.", 3, "neither", "lowest voltage of those nodes and steps",
        "min", over_episodes="min", tables=("run", "check")),
    Metric("voltage_max_pu", "highest voltage", "p.u.", 3, "neither", "highest voltage of those nodes and steps",
        "max", over_episodes="max", tables=("run", "check")),
    Metric("voltage_step_mean_pu", "1-step voltage change", "1e-3 p.u.", 2, "lower",
        "mean abs(V_t - V_{t-1}) of those nodes, over one step", "mean", tables=("run",), scale=1000.0),
)  # fmt: skip
"""Cost and voltages."""


FLOW = (
    Metric("loss_mean_kw", "mean loss", "kW", 1, "lower",
        "mean loss of the feeder: branches, and cores of three-phase transformers", "mean", tables=("run",)),
    Metric("loss_energy_kwh", "energy lost", "kWh", 2, "lower", "energy of that loss", "sum"),
    Metric("q_effort_pct", "effort", "% of rating", 1, "lower", "mean abs(q) as a share of the apparent-power rating",
        "mean", tables=("evaluate", "benchmark")),
)  # fmt: skip
"""Losses and reactive power."""


PHASES = (
    Metric("unbalance_mean_pct", "mean voltage unbalance", "%", 2, "lower",
        "mean voltage unbalance factor abs(V2 / V1) of three-phase buses over the steps 1 .. T", "mean"),
    Metric("unbalance_max_pct", "highest voltage unbalance", "%", 2, "lower",
        "largest voltage unbalance factor of a three-phase bus", "max", over_episodes="max"),
    Metric("nema_unbalance_max_pct", "highest NEMA unbalance", "%", 2, "lower", "largest unbalance by NEMA MG 1",
        "max", over_episodes="max"),
    Metric("tap_moves", "taps moved", "", 1, "lower", "taps of all regulators in either direction", "sum"),
    Metric("capacitor_switchings", "capacitor switchings", "", 1, "lower", "switchings of all capacitor banks",
        "sum"),
)  # fmt: skip
"""Unbalance and equipment of three-phase feeders."""


AFTER_LOSS = (
    Metric("voltage_after_loss_max_pu", "highest voltage after a loss", "p.u.", 3, "lower",
        "highest voltage of the feeder in steps with a device away; 0 if there is none", "max", over_episodes="max",
        tables=("run",)),
)  # fmt: skip
"""Metrics of the grid where devices may leave it."""


END = (
    Metric("steps", "steps done", "", 0, "neither", "number of steps done", "sum"),
    Metric("power_flow_converged", "power flow converged", "", 0, "higher",
        "0 if the power flow ended the episode, else 1", "last"),
)  # fmt: skip
"""How an episode ended."""


class StreamingGrid:
    """Accumulates the metrics of the grid over an episode that comes in parts; one part is the whole episode."""

    def __init__(self, scenario: Scenario):
        self._combined = self._phases = Combined(PHASES)
        self._requests = Combined(load_requests.METRICS)
        self._fluctuation = StreamingFluctuation(scenario)
        self._order: dict[str, Any] = {}
        self._steps, self._mean, self._variance = 0, 0.0, 0.0
        """Mean and variance of abs(V - 1)."""
        self._outside = np.zeros(len(scenario.feeder.load_nodes), bool)

    def add(self, part: Any) -> None:
        """Take the next steps of the episode, a ``Series`` from the end of the part before on."""
        steps, figures = len(part.cost_j), _grid_figures(part)
        if not self._order:
            self._order = dict.fromkeys(figures)
            costs = (cost_metric(name, name) for name in part.costs)
            self._combined = Combined((*VOLTAGES, *FLOW, *overload.METRICS, *END, *costs))
        std, self._outside = figures.pop("voltage_deviation_std_pu"), self._outside | figures.pop("outside_buses_pct")
        self._combined.add(figures, steps)
        self._phases.add(_phase_figures(part), steps)
        requests, requested = load_requests.request_figures(part.scenario, part.p_kw, part.request)
        self._requests.add(requests, steps, {"grid_request_compliance_pct": requested})
        self._fluctuation.add(part.v_pu, part.p_kw_from_reset)
        self._steps += steps
        share, off = steps / self._steps, figures["voltage_deviation_mean_pu"] - self._mean
        self._variance = (1.0 - share) * (self._variance + share * off * off) + share * std * std
        self._mean += share * off

    def figures(self) -> dict[str, float]:
        """Metrics of all parts so far."""
        over_all = {
            "voltage_deviation_std_pu": math.sqrt(self._variance),
            "outside_buses_pct": 100.0 * self._outside.mean(),
        }
        figures = self._order | self._combined.figures() | over_all
        return figures | self._fluctuation.figures() | self._phases.figures() | self._requests.figures()


def _grid_figures(series: Any) -> dict[str, Any]:
    """Metrics of costs, voltages, losses and loadings of a ``Series``, and which nodes are ever outside the band."""
    s = series.scenario
    v = series.v_pu[1:, s.feeder.load_slice]
    deviation = np.abs(v - 1.0)
    outside = deviation > s.cost.band_pu
    converters = [device for device in s.devices if not is_equipment(device)]  # which stand first
    ratings = np.concatenate([device.converter_kva for device in converters])
    return {
        "J": series.cost_j.sum() / s.horizon,
        **{f"cost_{name}": values.sum() / s.horizon for name, values in series.costs.items()},
        "voltage_deviation_mean_pu": deviation.mean(),
        "voltage_deviation_std_pu": deviation.std(),
        "outside_bus_seconds_pct": 100.0 * outside.mean(),
        "outside_buses_pct": outside.any(axis=0),
        "voltage_min_pu": v.min(),
        "voltage_max_pu": v.max(),
        "voltage_step_mean_pu": np.abs(np.diff(series.v_pu[:, s.feeder.load_slice], axis=0)).mean(),
        "loss_mean_kw": series.loss_kw.mean(),
        "loss_energy_kwh": series.loss_kw.sum() * s.dt_s / 3600.0,
        "q_effort_pct": 100.0 * (np.abs(series.q_kvar[:, : len(ratings)]) / ratings).mean() if len(ratings) else 0.0,
        "steps": len(v),
        "power_flow_converged": series.converged,
        **overload.overload_figures(s, series.loading),
    }


def _phase_figures(series: Any) -> dict[str, Any]:
    """Metrics of the unbalance and of the equipment of a ``Series`` on a three-phase feeder; none on a balanced one."""
    feeder, phases = series.scenario.feeder, series.three_phase
    if not isinstance(feeder, ThreePhaseFeeder):
        return {}
    factor = phases.unbalance[1:]
    nema = nema_unbalance(three_phase_nodes(feeder), phases.v_re_pu[1:], phases.v_im_pu[1:])
    regulators, banks = phases.equipment
    return {
        "unbalance_mean_pct": 100.0 * factor.mean() if factor.size else 0.0,
        "unbalance_max_pct": 100.0 * factor.max(initial=0.0),
        "nema_unbalance_max_pct": 100.0 * nema.max(initial=0.0),
        "tap_moves": regulators.moved[1:].sum(),
        "capacitor_switchings": banks.switched[1:].sum(),
    }


def after_loss(scenario: Scenario, histories: Sequence[Any], v_pu: Array) -> dict[str, float]:
    """Highest voltage of the feeder from the first step in which devices left to the last in which some are away.

    Parameters
    ----------
    scenario
        The scenario; nothing is said of one whose devices cannot leave.
    histories
        State of each group over time, from the reset on.
    v_pu
        Voltages of the steps 1 .. T at nodes but the substation's, p.u., (T, node).
    """
    leaving_devices = disconnectable_devices(scenario)
    if not leaving_devices:
        return {}
    shares = [scenario.devices[i].connected(histories[i])[1:] for i in leaving_devices]  # pyright: ignore
    away = sum((share < 1.0).any(-1) for share in shares) > 0
    return {"voltage_after_loss_max_pu": v_pu[away].max(initial=0.0)}

"""Laws that can be tuned: the numbers that each is searched in, their bounds, and the parameters made from them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from dcgrid_env import Scenario, action_layout, believed_sensitivity, nodes_by_bus, under_own_control
from dcgrid_env.baselines.controller import Controller
from dcgrid_env.baselines.laws.constant_set_points import (
    ConstantSetPoints,
    SetPoint,
    TwoTimescale,
    has_set_points,
    offset_overrides,
    open_set_points,
)
from dcgrid_env.baselines.laws.deadband import DeadbandDroop
from dcgrid_env.baselines.laws.droop import Droop
from dcgrid_env.baselines.laws.fixed_smoothing import FixedSmoothing, has_smoothing_channels, smoothing_of
from dcgrid_env.baselines.laws.peak_shaving import PeakShaving, has_storages
from dcgrid_env.baselines.laws.request_sharing import RequestSharing, has_requests
from dcgrid_env.baselines.laws.route_to_strongest import RouteToStrongest, has_routing
from dcgrid_env.baselines.laws.site_return import (
    SLOWEST_PACE,
    ReturnByHand,
    StaggeredReturn,
    has_return_channel,
    return_rule,
)
from dcgrid_env.baselines.laws.stability import largest_stable
from dcgrid_env.baselines.laws.static import ConstantQ, PlacementRule

Parameters = dict[str, Any]
_LOG_K_Q = (-2.0, 2.5)  # in episodes of _EPISODE_S at most, with steps of a second at most
_EPISODE_S = 120.0
_MEMBERS = 8  # episodes over whose feeders distances are taken where feeders are random


@dataclass(frozen=True)
class Tunable:
    """A law and how it is searched: in numbers ``x`` within bounds, from which its parameters are made."""

    law: Callable[..., Controller]
    parameters: Callable[[np.ndarray, Sequence[Scenario]], Parameters]
    """From x and the scenarios that share the parameters to the law's keyword arguments."""
    bounds: Callable[[Sequence[Scenario]], list[tuple[float, float]]]
    generations: int | None = None
    """Generations of differential evolution; None for three where there are up to three parameters, else none."""
    fits: Callable[[Scenario], bool] = lambda _: True
    """Whether the law can drive a scenario at all."""
    by_cross_entropy: bool = False
    """Whether the cross-entropy method searches the parameters, all candidates in one batch."""
    overrides: Callable[[Scenario, Parameters], dict[str, Any]] = lambda *_: {}
    """Fields of the scenario that the parameters require, see ``Scenario.replace``."""


def _droop(x: np.ndarray, _: Sequence[Scenario]) -> Parameters:
    return {"k_p_mw_per_pu": _rounded(x[0]), "k_q_mvar_per_pu_s": _power(x[1]), "alpha_per_s": _power(x[2])}


def _peak_shaving(x: np.ndarray, scenarios: Sequence[Scenario]) -> Parameters:
    return _droop(x[:3], scenarios) | {"v_hold_pu": _rounded(x[3]), "gain": _power(x[4])}


def _routing(x: np.ndarray, scenarios: Sequence[Scenario]) -> Parameters:
    return _droop(x[:3], scenarios) | {"route_gain_per_pu": _power(x[3]), "look_ahead": _rounded(x[4])}


def _request(x: np.ndarray, scenarios: Sequence[Scenario]) -> Parameters:
    """Gains of the droop, the weight of the queue, and the ramp in advance as a share of the notice."""
    notice_s = min(s.grid_request.notice_s for s in scenarios)
    return _droop(x[:3], scenarios) | {"backlog_weight_per_s": _power(x[3]), "advance_s": _rounded(x[4] * notice_s)}


def _k_q_bounds(scenarios: Sequence[Scenario]) -> tuple[float, float]:
    """Bounds of log10 k_q, an integral gain: the longer an episode, the slower it may be, and the longer a step, the
    sooner it oscillates.
    """
    episode_s = max(_EPISODE_S, *(s.horizon * s.dt_s for s in scenarios))
    step_s = max(1.0, min(s.dt_s for s in scenarios))
    return _LOG_K_Q[0] - float(np.log10(episode_s / _EPISODE_S)), _LOG_K_Q[1] - float(np.log10(step_s))


def _droop_bounds(scenarios: Sequence[Scenario]) -> list[tuple[float, float]]:
    return [(0.0, 20.0), _k_q_bounds(scenarios), (-3.0, 0.3)]


def _request_bounds(scenarios: Sequence[Scenario]) -> list[tuple[float, float]]:
    """Bounds of the droop's gains, with k_q up to its largest stable value, of the queue's weight and of the ramp.

    A faster reactive axis would oscillate at its limits, which the cost hardly charges.
    """
    k_p, (low, high), alpha = _droop_bounds(scenarios)
    stable = min(largest_stable(s, k_p_mw_per_pu=0.0) for s in scenarios)
    return [k_p, (low, max(low, min(high, float(np.log10(stable))))), alpha, (-3.0, 1.0), (0.0, 1.0)]


def _constant(x: np.ndarray, scenarios: Sequence[Scenario]) -> Parameters:
    if len(scenarios) > 1:
        return {"q_share": _rounded(x[0])}
    gives = _gives_reactive_power(scenarios[0])
    shares = np.zeros(len(gives))
    # Data centres that are drawn anew in each episode are all alike beforehand.
    shares[gives] = [*([x[0]] * (gives.sum() - len(x))), *x]
    return {"q_share": tuple(map(_rounded, shares))}


def _constant_bounds(scenarios: Sequence[Scenario]) -> list[tuple[float, float]]:
    if len(scenarios) > 1:
        return [(-1.0, 1.0)]
    scenario, n = scenarios[0], int(_gives_reactive_power(scenarios[0]).sum())
    drawn = scenario.datacenters.buses is None and scenario.datacenters.count > 0
    return [(-1.0, 1.0)] * (n - scenario.datacenters.count + 1 if drawn else n)


def _gives_reactive_power(scenario: Scenario) -> np.ndarray:
    """Which agents that a law drives have reactive power, bool, (n_agent,)."""
    return action_layout(under_own_control(scenario)).reactive >= 0


def _placement(x: np.ndarray, scenarios: Sequence[Scenario]) -> Parameters:
    """sinh(x): the share at the agents' mean R_ii and X_ii, and its change over the range of each among them.

    By sinh gentle rules are searched more finely than steep ones, which saturate at most agents.
    """
    distances = np.concatenate([_distances(member) for s in scenarios for member, _ in s.members(range(_MEMBERS))])
    middle, *changes = np.sinh(x)
    slopes = changes / np.ptp(distances, axis=0)
    names = ("at_substation", "per_r_mw_per_pu", "per_x_mvar_per_pu")
    return dict(zip(names, map(_rounded, (middle - slopes @ distances.mean(axis=0), *slopes)), strict=True))


def _distances(scenario: Scenario) -> np.ndarray:
    """R_ii and X_ii of every possible bus of an agent, (n, 2)."""
    first, rows = 0, []
    for device in scenario.devices:
        buses = device.buses
        if buses is None:
            rows += [(first, bus) for bus in scenario.candidates.tolist()]
        else:
            rows += [(first + i, scenario.feeder.index(bus)) for i, bus in enumerate(buses)]
        first += device.count
    agents, places = np.array(rows).T
    nodes = nodes_by_bus(scenario)[agents, places]
    values = (matrix[nodes[:, :, None], nodes[:, None, :]].mean((-1, -2)) for matrix in believed_sensitivity(scenario))
    return np.stack(list(values), axis=-1)


def _by_hand(x: np.ndarray, scenarios: Sequence[Scenario]) -> Parameters:
    """k_p and k_q of the droop, both times as shares of what ``ups_wait`` counts to, and the pace."""
    longest_s = min(return_rule(s).longest_wait_s(s.datacenters.count) for s in scenarios)
    times = {"return_delay_s": _rounded(x[2] * longest_s), "release_s": _rounded(x[3] * longest_s)}
    return {"k_p_mw_per_pu": _rounded(x[0]), "k_q_mvar_per_pu_s": _power(x[1]), **times, "pace": _rounded(x[4])}


def _staggered(x: np.ndarray, scenarios: Sequence[Scenario]) -> Parameters:
    """The same, and how far apart sites return as a share of what is left of that time."""
    first = _by_hand(x, scenarios)
    latest_s = max(*(return_rule(s).return_delay_s for s in scenarios), first["return_delay_s"], first["release_s"])
    longest_s = min(return_rule(s).longest_wait_s(s.datacenters.count) for s in scenarios)
    apart = max(1, *(s.datacenters.count - 1 for s in scenarios))
    return first | {"stagger_s": _rounded(0.999 * x[5] * (longest_s - latest_s) / apart)}


def _return_bounds(scenarios: Sequence[Scenario]) -> list[tuple[float, float]]:
    return [(0.0, 5.0), _k_q_bounds(scenarios), (0.0, 1.0), (0.0, 1.0), (SLOWEST_PACE, 1.0)]


def _smoothing(x: np.ndarray, scenarios: Sequence[Scenario]) -> Parameters:
    """Gains of the droop, the floor, and ramps between the slowest and the fastest, by factors."""
    settings = [smoothing_of(s) for s in scenarios]
    slowest = min(np.log10(setting.slowest_share) for setting in settings)
    up, down = (min(getattr(setting, f"ramp_{way}_w_per_s") for setting in settings) for way in ("up", "down"))
    return {
        **_droop(x[:3], scenarios),
        "floor_share": _rounded(x[3] * min(setting.floor_share for setting in settings)),
        "ramp_up_w_per_s": _rounded(up * 10.0 ** (slowest * x[4])),
        "ramp_down_w_per_s": _rounded(down * 10.0 ** (slowest * x[5])),
    }


_STEP = {"offset_v": 0.1, "half_band_v": 0.1, "centre_pu": 0.001}
"""Resolution of the settings of controls, in the unit of the parameter."""


def _set_points(x: np.ndarray, scenarios: Sequence[Scenario]) -> Parameters:
    parameters: Parameters = {}
    for point, value in zip(_points(scenarios), x.tolist(), strict=True):
        step = _STEP[point.parameter]
        rounded = round(min(max(step * round(value / step), point.lowest), point.highest), 6)
        parameters.setdefault(point.parameter, {})[point.name] = rounded
    return parameters


def _set_points_and_q(x: np.ndarray, scenarios: Sequence[Scenario]) -> Parameters:
    n = len(_points(scenarios))
    return _set_points(x[:n], scenarios) | _constant(x[n:], scenarios)


def _two_timescale(x: np.ndarray, scenarios: Sequence[Scenario]) -> Parameters:
    fast = {"slope_per_pu": _power(x[-2]), "response_s": _rounded(scenarios[0].dt_s * 10.0 ** x[-1])}
    return _set_points_and_q(x[:-2], scenarios) | fast


def _set_point_bounds(scenarios: Sequence[Scenario]) -> list[tuple[float, float]]:
    return [(point.lowest, point.highest) for point in _points(scenarios)]


def _points(scenarios: Sequence[Scenario]) -> list[SetPoint]:
    """Return the open set points of one scenario; ValueError for several, or a scenario without any."""
    if len(scenarios) > 1:
        names = ", ".join(scenario.name for scenario in scenarios)
        raise ValueError(f"tune: set points belong to one scenario, got {names}; tune each by itself")
    points = open_set_points(scenarios[0])
    if not points:
        ConstantSetPoints().reset(scenarios[0])  # raises the error
    return points


def _offset_overrides(scenario: Scenario, parameters: Parameters) -> dict[str, Any]:
    return offset_overrides(scenario, parameters.get("offset_v", {}))


TUNABLE: dict[str, Tunable] = {
    "droop": Tunable(Droop, _droop, _droop_bounds),
    "droop-q": Tunable(
        Droop, lambda x, _: {"k_p_mw_per_pu": 0.0, "k_q_mvar_per_pu_s": _power(x[0])}, lambda s: [_k_q_bounds(s)]
    ),
    "deadband": Tunable(
        DeadbandDroop,
        lambda x, _: {"k_share_per_pu": _power(x[0]), "deadband_pu": _rounded(x[1])},
        lambda _: [(0.0, 3.5), (0.0, 0.03)],
    ),
    "peak-shaving": Tunable(
        PeakShaving,
        _peak_shaving,
        lambda s: [(0.0, 20.0), _k_q_bounds(s), (-3.0, 0.3), (0.9, 1.0), (-2.0, 0.5)],
        fits=has_storages,
    ),
    "route-to-strongest": Tunable(
        RouteToStrongest, _routing, lambda s: [*_droop_bounds(s), (0.0, 3.0), (0.0, 1.5)], fits=has_routing
    ),
    "request-sharing": Tunable(RequestSharing, _request, _request_bounds, fits=has_requests),
    # Trips make steps of the cost, in which a method that follows slopes stays where it begins.
    "return-by-hand": Tunable(ReturnByHand, _by_hand, _return_bounds, 6, has_return_channel),
    "staggered-return": Tunable(
        StaggeredReturn, _staggered, lambda s: [*_return_bounds(s), (0.0, 1.0)], 6, has_return_channel
    ),
    "smoothing": Tunable(
        FixedSmoothing,
        _smoothing,
        lambda s: [(0.0, 20.0), _k_q_bounds(s), (-3.0, 0.3), (0.0, 1.0), (0.0, 1.0), (0.0, 1.0)],
        fits=has_smoothing_channels,
    ),
    "constant-q": Tunable(ConstantQ, _constant, _constant_bounds),
    # The cost has plateaus and several valleys: the rule saturates.
    "placement": Tunable(PlacementRule, _placement, lambda _: [(-2.0, 2.0), (-3.5, 3.5), (-3.5, 3.5)], 12),
    # Taps make steps of the cost, and banks act on each other.
    "set-points": Tunable(
        ConstantSetPoints,
        _set_points,
        _set_point_bounds,
        fits=has_set_points,
        by_cross_entropy=True,
        overrides=_offset_overrides,
    ),
    "static": Tunable(
        ConstantSetPoints,
        _set_points_and_q,
        lambda s: [*_set_point_bounds(s), *_constant_bounds(s)],
        fits=has_set_points,
        by_cross_entropy=True,
        overrides=_offset_overrides,
    ),
    "two-timescale": Tunable(
        TwoTimescale,
        _two_timescale,
        lambda s: [*_set_point_bounds(s), *_constant_bounds(s), (0.0, 2.0), (0.0, 1.8)],
        fits=has_set_points,
        by_cross_entropy=True,
        overrides=_offset_overrides,
    ),
}
"""Laws that can be tuned, by the names of ``CONTROLLERS``."""


def _rounded(value: float) -> float:
    """Round to four significant digits, so the printed gain equals the gain that was tried."""
    return float(f"{round(float(value), 9):.4g}")


def _power(exponent: float) -> float:
    return _rounded(10.0**exponent)

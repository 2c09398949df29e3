"""Requests of a utility as an episode draws them, and what of them holds and is announced in an interval."""

from __future__ import annotations

import numpy as np

from dcgrid_env.core import random
from dcgrid_env.core.cache import cached_on_owner
from dcgrid_env.scenario.costs.load_requests import RequestColumns, rated_kw
from dcgrid_env.scenario.grid_request import draw_range
from dcgrid_env.scenario.scenario import Scenario

_ROUNDING_S = 1e-9


def drawn_requests(scenario: Scenario, key: np.ndarray) -> np.ndarray:
    """Return start, ramp and duration, s, and value of each request, (row, n_request, 4).

    The value is a share of the sum of the sites' ratings.
    """
    targets = scenario.grid_request.targets
    part = random.uniform(key, random.LOAD_TARGET, 4 * len(targets)).reshape(len(key), -1, 4)
    per_mw = 1000.0 / rated_kw(scenario) if targets else 1.0
    ranges = [
        (target.begin_s, target.ramp_s, target.duration_s, target.value_share or _scaled(target.value_mw, per_mw))
        for target in targets
    ]
    bounds = np.array(ranges).reshape(-1, 4, 2)
    return bounds[..., 0] + part * (bounds[..., 1] - bounds[..., 0])


def _scaled(values: tuple[float, float] | None, factor: float) -> tuple[float, float]:
    low, high = values or (0.0, 0.0)
    return low * factor, high * factor


def request_columns(scenario: Scenario, drawn: np.ndarray, step: np.ndarray, p_ref_kw: np.ndarray) -> np.ndarray | None:
    """Return ``Exogenous.request`` of the interval that ends at ``step`` (row,); None in a scenario without requests.

    Parameters
    ----------
    scenario
        The scenario.
    drawn
        Requests of the episode, see :func:`drawn_requests`.
    step
        (row,) int64.
    p_ref_kw
        Draw of the sites over the interval at the top clock with nothing queued, kW, (row, n_site).

    Returns
    -------
    np.ndarray or None
        The columns of :class:`RequestColumns`, (row, n_column).
    """
    request = scenario.grid_request
    if not request.targets:
        return None
    t_s, next_s = step * scenario.dt_s, (step + 1) * scenario.dt_s
    notice_s = request.notice_s or 1.0
    lower, upper, _ = _in_force(scenario, drawn, t_s)
    lower_next, upper_next, end_s = _in_force(scenario, drawn, next_s)
    left = np.clip((end_s - t_s) / notice_s, 0.0, 1.0)

    begin_s = drawn[..., 0]
    known = (begin_s + _ROUNDING_S >= next_s[:, None]) & (begin_s - t_s[:, None] <= request.notice_s)
    coming_s = np.where(known, begin_s, np.inf)
    first = coming_s.argmin(axis=1)[:, None]
    announced = np.take_along_axis(known, first, 1)[:, 0]
    wait = np.where(announced, (coming_s.min(axis=1, initial=np.inf) - t_s) / notice_s, 1.0)
    value = np.take_along_axis(drawn[..., 3], first, 1)[:, 0]
    is_cap, (lowest, highest) = _caps(scenario)[first[:, 0]], draw_range(scenario)
    return np.stack(
        RequestColumns(
            lower,
            upper,
            p_ref_kw.sum(axis=1) / rated_kw(scenario),
            lower_next,
            upper_next,
            left,
            np.minimum(wait, 1.0),
            np.where(announced & ~is_cap, value, lowest),
            np.where(announced, value, highest),
        ),
        axis=-1,
    )


def _in_force(scenario: Scenario, drawn: np.ndarray, t_s: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the range that is requested at ``t_s`` (row,), and its end, s, 0 without a request; (row,) each."""
    begin_s, ramp_s, duration_s, value = np.moveaxis(drawn, -1, 0)
    now_s = t_s[:, None]
    on = (begin_s + _ROUNDING_S < now_s) & (now_s <= begin_s + duration_s + _ROUNDING_S)
    priority = np.where(on, _priorities(scenario), -1)
    strongest = on & (priority == priority.max(axis=1, keepdims=True))
    chosen = np.where(strongest, begin_s, -1.0).argmax(axis=1)[:, None]

    def of_chosen(values: np.ndarray) -> np.ndarray:
        return np.take_along_axis(values, chosen, 1)[:, 0]

    part = np.where(ramp_s > 0.0, np.minimum((now_s - begin_s) / np.where(ramp_s > 0.0, ramp_s, 1.0), 1.0), 1.0)
    part, (lowest, highest) = of_chosen(np.where(on, part, 0.0)), draw_range(scenario)
    requested, is_cap = of_chosen(value), _caps(scenario)[chosen[:, 0]]
    lower = np.where(is_cap, lowest, lowest + (requested - lowest) * part)
    end_s = of_chosen(np.where(on, begin_s + duration_s, 0.0))
    return lower, highest + (requested - highest) * part, end_s


@cached_on_owner
def _caps(scenario: Scenario) -> np.ndarray:
    """Return which requests are caps, (n_request,)."""
    return np.array([target.kind == "cap" for target in scenario.grid_request.targets])


@cached_on_owner
def _priorities(scenario: Scenario) -> np.ndarray:
    """Return the priorities of the requests, (n_request,)."""
    return np.array([target.priority for target in scenario.grid_request.targets])

"""Whether a limit on ramps fits the scenario that it stands in: its sites, its steps and the length of its episodes."""

from __future__ import annotations

from typing import Any

from dcgrid_env.core.checked import FieldError

MOST_STEPS = 10_000
"""Longest window in steps. It may reach beyond an episode: before it a site has always drawn what it draws at t = 0."""


def check_ramp_limit(scenario: Any) -> None:
    """Raise FieldError for a limit without a site, or a window that no whole number of steps makes up."""
    if scenario.ramp_limit_kw_per_s is not None and not scenario.n_sites:
        limit = scenario.ramp_limit_kw_per_s
        raise FieldError("Cost", "ramp_limit_kw_per_s", limit, "leave it out: the scenario has no data centre")
    window_s, dt_s = scenario.ramp_window_s, scenario.dt_s
    if window_s is None:
        return
    steps = round(window_s / dt_s)
    if not 1 <= steps <= MOST_STEPS or abs(steps * dt_s - window_s) > 1e-6 * window_s:
        remedy = f"give a whole number of steps of {dt_s:g} s, {MOST_STEPS:,} of them at most"
        raise FieldError("Cost", "ramp_window_s", window_s, remedy)

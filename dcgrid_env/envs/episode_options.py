"""Options of a reset that replace a draw: the agents' buses and the time of day."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from dcgrid_env.scenario.scenario import Scenario

if TYPE_CHECKING:
    from dcgrid_env.engine.exogenous.episode import EpisodeOptions


def episode_options(scenario: Scenario, num_envs: int, options: Mapping[str, Any]) -> EpisodeOptions | None:
    """Return the buses and the time of day in the ``options`` of a reset; None for those that are missing.

    Raises
    ------
    ValueError
        If ``buses`` are not positions of buses other than the substation, (num_envs, n_agents); if ``begin_h`` is not
        a time of day, (num_envs,), with load profiles a time within the file, or the scenario does not follow the day.
    """
    buses, begin_h = options.get("buses"), options.get("begin_h")
    if buses is None and begin_h is None:
        return None
    from dcgrid_env.engine.exogenous.episode import EpisodeOptions  # brings the compiler with it, so not on import

    n_bus = scenario.feeder.n_bus
    if buses is not None:
        buses = np.asarray(buses)
        want = (num_envs, scenario.n_agents)
        whole = buses.dtype.kind in "iu" and buses.shape == want
        if not whole or ((buses < 1) | (buses >= n_bus)).any():
            raise ValueError(f"buses must be whole numbers in 1 to {n_bus - 1}, positions in bus_ids, of shape {want}")
        buses = buses.astype(np.int64)
    if begin_h is not None:
        begin_h = np.asarray(begin_h, dtype=np.float64)
        low, high, suffix = _begins(scenario)
        if begin_h.shape != (num_envs,) or not ((begin_h >= low - 1e-9) & (begin_h < high)).all():
            raise ValueError(
                f"begin_h must be hours from {low:g} to less than {high:g}{suffix}, of shape {(num_envs,)}"
            )
        if not scenario.follows_day:
            raise ValueError("begin_h is given, but the scenario does not follow the day; give background.start_hour")
    return EpisodeOptions(buses, begin_h)


def _begins(scenario: Scenario) -> tuple[float, float, str]:
    """Return the range of the begin of an episode, h, and what it counts from."""
    profiles = scenario.load_profiles
    if profiles.file is None:
        return 0.0, 24.0, ""
    low, high = profiles.file.begin_h, profiles.file.begin_h + profiles.file.duration_h
    if profiles.days != "repeat":
        high -= scenario.horizon * scenario.dt_s / 3600.0 - 1e-6
    return low, high, " since the midnight before the first sample of load_profiles.file"

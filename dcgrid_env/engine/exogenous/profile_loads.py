"""Loads by the profiles of a file, before their noise."""

from __future__ import annotations

import numpy as np

from dcgrid_env.core.cache import cached_on_owner
from dcgrid_env.scenario.load_profiles import ProfileWeights, profile_begins_h, profile_weights
from dcgrid_env.scenario.scenario import Scenario


def profile_loads(scenario: Scenario, hour: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the loads at times, kW and kvar, (row, n_leg).

    Parameters
    ----------
    scenario
        A scenario with load profiles.
    hour
        Time, h since the midnight before the file's first sample, (row,).
    """
    profiles, weights = scenario.load_profiles, _weights(scenario)
    values = profiles.table.values_at(hour, linear=profiles.between == "linear", repeat=profiles.days == "repeat")
    p_kw, q_kvar = (np.tile(rest, (len(hour), 1)) for rest in (weights.p_rest_kw, weights.q_rest_kvar))
    p_kw[:, weights.legs] = values[:, weights.p_column] * weights.p_weight
    q_kvar[:, weights.legs] = values[:, weights.q_column] * weights.q_weight
    return p_kw, q_kvar


def drawn_start_h(scenario: Scenario, part: np.ndarray) -> np.ndarray:
    """Return the begin of episodes for draws in [0, 1), (row,), h since the midnight before the first sample."""
    low, high = _starts(scenario).T
    lengths = high - low
    ends = np.cumsum(lengths)
    if not ends[-1] > 0.0:
        return low[(part * len(low)).astype(np.int64)]
    position = part * ends[-1]
    chosen = np.searchsorted(ends, position, side="right")
    return high[chosen] - (ends[chosen] - position)


@cached_on_owner
def _weights(scenario: Scenario) -> ProfileWeights:
    return profile_weights(scenario.feeder, scenario.load_profiles)


@cached_on_owner
def _starts(scenario: Scenario) -> np.ndarray:
    return profile_begins_h(scenario)

"""The best that is known of an episode that no linear program plans: a search of it alone, with all of it known.

Trips are no linear program, and neither is smoothing by settings that are held for seconds, so there is no optimum to
measure with. What stands in its place is the least cost that anyone has been seen to reach in that very episode: by
the rule of a staggered return, its times, pace and gains fitted to the episode itself, or of smoothing at a fixed
profile, its floors, ramps and gains fitted to it; or by one of the controllers that are named. It is no bound, and
whoever reaches less makes it lower.

The fit is the cross-entropy method (R. Y. Rubinstein, 1999): in each generation parameters are drawn around those of
the best quarter so far, from the tuned rule on. All candidates of all episodes are lanes of one batch.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from dcgrid_env import Recorder, Scenario
from dcgrid_env.baselines.controller import Controller, Local
from dcgrid_env.baselines.laws.fixed_smoothing import has_smoothing_channels
from dcgrid_env.baselines.laws.site_return import SLOWEST_PACE, StaggeredReturn, return_rule
from dcgrid_env.baselines.rollout import rollout
from dcgrid_env.baselines.tuning.lane_costs import lane_costs
from dcgrid_env.baselines.tuning.lane_smoothing import LaneSmoothing, smoothing_bounds, smoothing_start
from dcgrid_env.baselines.tuning.tuned import tuned_parameters

GENERATIONS, CANDIDATES = 20, 32
LONG_GENERATIONS = 6
"""Generations where power is smoothed: such episodes have 6000 steps."""
LANES = 800
"""Lanes of a batch."""
SEARCH = "search"
"""What is named where nobody reached less than the search."""
DIGITS = 6
"""Digits of parameters, with which they are tried and kept."""
_BEST = 8
_KEPT = 0.3


class Searched(NamedTuple):
    """What the search reached in an episode."""

    J: float
    x: tuple[float, ...]
    """Parameters of the law that is searched over, see :func:`searched_law`."""


class BestKnown(NamedTuple):
    """The least cost of an episode."""

    J: float
    by: str
    """Who reached it: a controller's name, or ``SEARCH``."""
    searched: Searched


class LaneReturn(StaggeredReturn):
    """A staggered return with parameters of its own in each lane.

    Parameters
    ----------
    x
        (lane, 6 + n_datacenters): k_p in MW/p.u.; log10 of k_q of sites and of all others in Mvar/p.u. s; the voltage
        that the droop holds, p.u.; the pace; log10 of the times in s from a site's last event to its return; see
        :func:`start`, and ``bounds``.
    """

    def __init__(self, x: np.ndarray):
        super().__init__()
        self._x = x

    def reset(self, env_info: Scenario) -> None:
        """Begin new episodes, as many as there are rows of parameters."""
        super().reset(env_info)
        x, sites = self._x, env_info.n_datacenters
        gains = 10.0 ** np.repeat(x[:, 1:3], (sites, env_info.n_agents - sites), axis=1)
        self.k_p_mw_per_pu, self.k_q_mvar_per_pu_s = x[:, :1], gains  # pyright: ignore[reportAttributeAccessIssue]
        self.pace = x[:, 4:5]  # pyright: ignore[reportAttributeAccessIssue]
        self._delay_s = self._release_s = 10.0 ** x[:, 5:]

    def control(self, local: Local) -> tuple[np.ndarray, np.ndarray]:
        """Hold another voltage than 1 p.u., see :class:`LocalController`."""
        return super().control(local._replace(v_pu=local.v_pu - self._x[:, 3:4] + 1.0))


def bounds(scenario: Scenario) -> np.ndarray:
    """Lowest and highest of each parameter of :class:`LaneReturn`, (2, n)."""
    rule, sites = return_rule(scenario), scenario.n_datacenters
    times = [(np.log10(max(rule.return_delay_s, 1.0)), np.log10(rule.longest_wait_s(sites)))] * sites
    return np.array([(0.0, 20.0), (-2.5, 1.0), (-2.5, 1.0), (0.95, 1.05), (SLOWEST_PACE, 1.0), *times]).T


def start(scenario: Scenario) -> np.ndarray:
    """The tuned staggered return as parameters of :class:`LaneReturn`, (n,)."""
    tuned = tuned_parameters("staggered-return", scenario).parameters
    apart_s = tuned["stagger_s"] * np.arange(scenario.n_datacenters)
    k_q = np.log10(tuned["k_q_mvar_per_pu_s"])
    return np.array(
        [tuned["k_p_mw_per_pu"], k_q, k_q, 1.0, tuned["pace"], *np.log10(np.maximum(tuned["release_s"] + apart_s, 1.0))]
    )


class SearchedLaw(NamedTuple):
    """What an episode is searched over."""

    make: Callable[[np.ndarray], Controller]
    """From parameters (lane, n) to a controller of as many lanes."""
    bounds: np.ndarray
    """Lowest and highest of each parameter, (2, n)."""
    start: np.ndarray
    """Those to begin with, (n,)."""
    generations: int
    """Generations of the search."""


def searched_law(scenario: Scenario) -> SearchedLaw:
    """The law that episodes of a scenario are searched over.

    ValueError for a scenario whose agents decide over neither return nor smoothing, or without tuned parameters.
    """
    if has_smoothing_channels(scenario):
        return SearchedLaw(LaneSmoothing, smoothing_bounds(scenario), smoothing_start(scenario), LONG_GENERATIONS)
    return SearchedLaw(LaneReturn, bounds(scenario), start(scenario), GENERATIONS)


def best_known(
    scenario: Scenario,
    seeds: Sequence[int],
    controllers: Mapping[str, Controller],
    searched: Mapping[int, Searched] | None = None,
) -> list[BestKnown]:
    """The least cost that is known of each episode.

    Parameters
    ----------
    scenario
        One whose agents decide over the return, with a tuned staggered return; or over smoothing, with a tuned one.
    seeds
        One episode each. What is found of an episode does not depend on the others.
    controllers
        Who else is asked, by name.
    searched
        What the search reached before, by seed; these episodes are not searched again.

    Raises
    ------
    ValueError
        For a scenario without these channels, or without the tuned law.
    """
    known = dict(searched or {})
    due = [seed for seed in seeds if seed not in known]
    each = max(1, LANES // CANDIDATES)
    for i in range(0, len(due), each):
        known |= zip(due[i : i + each], _search(scenario, due[i : i + each]), strict=True)
    found = [BestKnown(known[seed].J, SEARCH, known[seed]) for seed in seeds]
    for name, controller in controllers.items():
        j = rollout(scenario, controller, seeds, name=name).costs().tolist()
        found = [best._replace(J=own, by=name) if own < best.J else best for own, best in zip(j, found, strict=True)]
    return found


def replayed(
    scenario: Scenario, records: Sequence[Mapping[str, Any]], find: Callable[[str, Scenario], Controller]
) -> Iterator[tuple[list[int], Recorder]]:
    """Drive episodes again as their records say; the seeds that one controller drove together, and their episodes.

    Parameters
    ----------
    scenario
        What the records are of.
    records
        Records of ``dcgrid dev best-known``.
    find
        Makes a controller from its name.
    """
    for who in dict.fromkeys(record["by"] for record in records):
        own = [record for record in records if record["by"] == who]
        if who == SEARCH:
            controller = searched_law(scenario).make(np.array([record["x"] for record in own]))
        else:
            controller = find(who, scenario)
        seeds = [record["seed"] for record in own]
        yield seeds, rollout(scenario, controller, seeds, name=who)


def _search(scenario: Scenario, seeds: Sequence[int]) -> list[Searched]:
    """The least cost that the search reaches in each episode."""
    make, (low, high), begin, generations = searched_law(scenario)
    draws = [np.random.default_rng([7, seed]) for seed in seeds]
    middle = np.repeat(np.clip(begin, low, high)[None], len(seeds), axis=0)
    spread = np.repeat(0.25 * (high - low)[None], len(seeds), axis=0)
    best_x, best_j = np.round(middle, DIGITS), np.zeros(len(seeds))
    lanes = np.repeat(np.asarray(seeds), CANDIDATES).tolist()
    for _ in range(generations):
        noise = np.stack([draw.standard_normal((CANDIDATES, len(low))) for draw in draws])
        x = np.round(np.clip(middle[:, None] + spread[:, None] * noise, low, high), DIGITS)
        x[:, 0] = best_x
        j = lane_costs(scenario, make(x.reshape(-1, len(low))), lanes).reshape(len(seeds), CANDIDATES)
        order = np.argsort(j, axis=1, kind="stable")[:, :_BEST]
        elite = np.take_along_axis(x, order[..., None], axis=1)
        best_x, best_j = elite[:, 0], np.take_along_axis(j, order[:, :1], axis=1)[:, 0]
        middle = _KEPT * middle + (1.0 - _KEPT) * elite.mean(axis=1)
        spread = _KEPT * spread + (1.0 - _KEPT) * elite.std(axis=1)
    return [Searched(float(j), tuple(own.tolist())) for j, own in zip(best_j, best_x, strict=True)]

"""Several data centres at once: which sizes they can have together.

``equal`` is max-min fairness. It raises all sizes together until a limit is reached, and then those that can still
grow. ``sum`` gives each site in turn all that is left. Of up to four sites it tries every order and takes the largest
sum. More sites are ordered by the capacity that each has alone, so that the sum is a lower bound.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import permutations
from typing import Any, Literal, get_args

import numpy as np

from dcgrid_env import Scenario
from dcgrid_env.apps.hosting.added_site import AddedSite
from dcgrid_env.apps.hosting.capacity_study import Study
from dcgrid_env.apps.hosting.hosting import UNCONTROLLED
from dcgrid_env.apps.hosting.load_hours import Windows, load_hours, with_worst_hours
from dcgrid_env.apps.hosting.site_scenario import with_sites
from dcgrid_env.apps.hosting.site_search import limit_of, overloaded_before
from dcgrid_env.apps.hosting.trial import ROUNDING, Trial, hour_margins, overloaded_nodes, run_trial
from dcgrid_env.apps.hosting.worst_hours import (
    exempt,
    moment_of,
    moments,
    reasons,
    snapshots,
    worst_hours,
)
from dcgrid_env.baselines.controller import Controller

Rule = Literal["equal", "sum"]
MOST_ORDERS = 4
"""Number of sites up to which every order is tried."""


class LimitsBroken(ValueError):
    """Error for a feeder on which limits are broken without any site, so that no size fits."""


@dataclass(frozen=True)
class Together:
    """Sizes of several sites that fit at once."""

    rule: str
    controller: str
    buses: tuple[str, ...]
    mw: tuple[float, ...]
    """Size at each bus, MW."""
    limits: tuple[str, ...]
    """Limit that is broken where this site alone is a step larger; empty for the largest size that is tried."""

    @property
    def sum_mw(self) -> float:
        """All sites together, MW."""
        return float(f"{sum(self.mw):.10g}")


def sites_together(
    study: Study, controller: Controller, name: str, rule: Rule, on_trial: Callable[[], None] | None = None
) -> Together:
    """Find sizes that the study's buses can have at once.

    Parameters
    ----------
    study
        Its ``buses`` are those of the sites.
    controller, name
        What drives the agents, and its name.
    rule
        ``equal`` or ``sum``, see above.
    on_trial
        Called after each set of windows, for progress.

    Raises
    ------
    ValueError
        For fewer than two buses or another rule.
    LimitsBroken
        For limits that are broken without any site. Overloads count only if a site is behind them.
    """
    if rule not in get_args(Rule):
        raise ValueError(f"together: must be one of {', '.join(get_args(Rule))}, got {rule!r}")
    if study.buses is None or len(set(study.buses)) < 2:
        raise ValueError("together: needs at least two buses; name them with buses")
    ids, buses = study.scenario.feeder.bus_ids, study.candidates()
    worst_alone = reasons(
        [str(ids[bus]) for bus in buses], [worst for _, worst in snapshots(study, buses, exempt(study))]
    )
    limiting = dict(worst_alone)
    while True:  # until the worst hours with all sites are among those of the windows
        result, worst = _search(study, limiting, controller, name, rule, on_trial)
        if worst <= limiting.keys():
            return result
        limiting |= dict.fromkeys(worst - limiting.keys(), "worst with all sites")


def _search(
    study: Study,
    limiting: dict[float, str],
    controller: Controller,
    name: str,
    rule: Rule,
    on_trial: Callable[[], None] | None,
) -> tuple[Together, set[float]]:
    """Find sizes with windows at some hours, and the hours that are worst with sites of these sizes, h."""
    windows = with_worst_hours(study, limiting)
    sites = _Sites(study, windows)
    moment = moment_of(study)
    every = _Sites(moment, moments(moment, load_hours(study).every), sites.exempt)
    bounding = _Sites(moment, moments(moment, np.array(list(limiting))), sites.exempt)

    def trial(sizes: tuple[int, ...]) -> Trial:
        rows = np.arange(len(windows))
        result = run_trial(sites, controller, sizes, np.zeros_like(rows), rows, name)  # pyright: ignore
        if on_trial is not None:
            on_trial()
        return result

    trial = lru_cache(maxsize=None)(trial)
    bounded = name == UNCONTROLLED and not study.allowed_pct

    def fits(sizes: Sequence[int]) -> bool:
        sizes = tuple(sizes)
        if bounded and hour_margins(bounding, sizes, 0).min() < -ROUNDING:  # pyright: ignore
            return False
        return int(trial(sizes).outside.sum()) <= study.allowed_seconds(len(windows))

    n = len(sites.buses)
    if not fits((0,) * n):
        raise LimitsBroken(f"together: limits are broken without any site: {limit_of(study.scenario, trial((0,) * n))}")
    sizes = _equal(fits, n, study.top) if rule == "equal" else _most(fits, n, study.top)
    limits = []
    for i in range(n):
        larger = tuple(size + (k == i) for k, size in enumerate(sizes))
        limits.append("" if sizes[i] == study.top else limit_of(study.scenario, trial(larger)))
    mw = tuple(float(f"{size * study.step_mw:.10g}") for size in sizes)
    together = Together(rule, name, tuple(study.scenario.feeder.bus_ids[bus] for bus in sites.buses), mw, tuple(limits))
    return together, set(worst_hours(every, tuple(sizes), 0)[0])


def _equal(fits: Callable[[Sequence[int]], bool], n: int, top: int) -> tuple[int, ...]:
    sizes, growing = [0] * n, list(range(n))
    while growing:  # all that still grow have one size
        level, base, among = sizes[growing[0]], tuple(sizes), frozenset(growing)
        raised = _largest(lambda size, base=base, among=among: fits(_raised(base, among, size)), level, top)
        sizes, left = _raised(sizes, among, raised), []
        for i in growing:  # one by one, at least one of them fails
            larger = _raised(sizes, {i}, raised + 1)
            if raised < top and fits(larger):
                sizes = larger
                left.append(i)
        growing = left
    return tuple(sizes)


def _most(fits: Callable[[Sequence[int]], bool], n: int, top: int) -> tuple[int, ...]:
    largest = [_largest(lambda size, i=i: fits(_raised((0,) * n, {i}, size)), 0, top) for i in range(n)]
    orders = permutations(range(n)) if n <= MOST_ORDERS else [tuple(sorted(range(n), key=lambda i: -largest[i]))]
    best: tuple[int, ...] = (0,) * n
    for order in orders:
        sizes: list[int] = [0] * n
        for i in order:
            size = _largest(lambda size, base=tuple(sizes), i=i: fits(_raised(base, {i}, size)), 0, largest[i])
            sizes = _raised(sizes, {i}, size)
        best = max(best, tuple(sizes), key=sum)
    return best


def _raised(sizes: Sequence[int], among: Any, size: int) -> list[int]:
    return [size if i in among else old for i, old in enumerate(sizes)]


def _largest(fits: Callable[[int], bool], low: int, top: int) -> int:
    """The largest size from ``low`` on that fits, by bisection; ``low`` fits."""
    high = top + 1
    while high - low > 1:
        middle = (low + high) // 2
        if fits(middle):
            low = middle
        else:
            high = middle
    return low


class _Sites:
    """The sites of a study at fixed buses, in the place of ``AddedSite``: a size is one for each of them."""

    def __init__(self, study: Study, windows: Windows, exempt: np.ndarray | None = None):
        self.study, self.windows = study, windows
        self.buses = study.candidates()
        self.exempt = overloaded_nodes(AddedSite(study, windows)) if exempt is None else exempt
        for bus in self.buses:
            if branch := overloaded_before(study.scenario.feeder, int(bus), self.exempt):
                raise LimitsBroken(f"together: no site fits at bus {study.scenario.feeder.bus_ids[bus]}: {branch}")
        self.slot = study.scenario.datacenters.count if study.others else 0
        self.scenario = lru_cache(maxsize=4)(self._scenario)

    def reset_arguments(self, buses: np.ndarray, samples: np.ndarray) -> tuple[list[int], dict[str, Any]]:
        """Seeds and reset options of windows; the buses are those of the scenario."""
        return samples.tolist(), self.windows.options(samples)

    def _scenario(self, sizes: tuple[int, ...], still: bool = False) -> Scenario:
        study, bus_ids = self.study, self.study.scenario.feeder.bus_ids
        mw = [size * study.step_mw for size in sizes]
        fields = study.window_fields | ({"background.load_sigma": 0.0} if still else {})
        return with_sites(study, [bus_ids[bus] for bus in self.buses], mw, **fields)

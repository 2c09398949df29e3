"""The worst hours of a study's loads by a power flow of every hour, and the windows that a study simulates.

Hours are the samples of the load profiles, or the quarters of an hour of a standard day. A site lowers the voltage of a
node by nearly the same amount in every hour, and raises the current of a branch likewise. The hours that limit a site
are therefore probably those of the lowest voltages of each node and of the highest currents of each branch without it.
The search for the capacity in one power flow begins with them; ``snapshot`` then goes through every hour with the site.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from dcgrid_env import Scenario, profile_begins_h, profile_loads, rating_coverage
from dcgrid_env.apps.hosting.capacity_study import PEAK_HOUR, Study
from dcgrid_env.apps.hosting.element_names import time_text
from dcgrid_env.apps.hosting.site_scenario import free_bus, still_fields, with_sites
from dcgrid_env.baselines.laws.no_control import NoControl
from dcgrid_env.baselines.rollout import as_driven, transitions
from dcgrid_env.traces import load_share

_VALUES = 2_000_000
"""Largest number of voltages of a batch."""
_RANKS = 5
"""Number of worst hours of each node and branch."""
MOST_HOURS = 256
"""Largest number of hours with which the search for the capacity in one power flow begins."""
_SHOWN = 6
"""Maximum number of worst hours that a sentence names."""
_DIGITS = 7
"""Decimals of voltages and loadings in which hours differ; of equal hours the first ones count."""
_GOLDEN = 0.5 * (5.0**0.5 - 1.0)
_CACHE = "_load_hours"


@dataclass(frozen=True)
class LoadHours:
    """Hours that probably limit a site, the worst ones of the feeder first."""

    hours: np.ndarray
    """Time of each, h: since the midnight before the first sample of the load profiles, or of the day, (hour,)."""
    reasons: tuple[str, ...]
    """Why each is worst, such as ``lowest voltage``; empty for one that is the worst of single nodes or branches."""
    every: np.ndarray
    """Time of every hour that was solved, h, (any,)."""
    loading: np.ndarray
    """Highest loading of each branch in them, (branch,); empty without known ratings, and at nominal load."""

    def named(self) -> list[int]:
        """Return the positions of the hours with a reason."""
        return [i for i, reason in enumerate(self.reasons) if reason]


@dataclass(frozen=True)
class Windows:
    """Windows of a study: those of sampled load first, then those at the worst hours, whose loads have no noise."""

    begin_h: np.ndarray | None
    """Begin of each, h, as ``Episode.begin_h``, (window,); None at nominal load."""
    hours: np.ndarray | None
    """Time of the load of each, h, which is the begin of sampled windows, (window,)."""
    reasons: tuple[str, ...]
    """Why the hour of each is worst; empty for sampled windows."""
    considered: int
    """Number of hours that the worst were chosen from; 0 at nominal load."""

    def __len__(self) -> int:
        return len(self.reasons)

    @property
    def still(self) -> np.ndarray:
        """Whether the loads of each are without noise, bool, (window,)."""
        return np.array([bool(reason) for reason in self.reasons])

    @property
    def sampled(self) -> int:
        """Number of windows of sampled load."""
        return self.reasons.count("")

    def options(self, samples: np.ndarray) -> dict[str, Any]:
        """Return the reset options that set the begins of some windows."""
        return {} if self.begin_h is None else {"begin_h": self.begin_h[samples]}


def hours_text(study: Study, n: int) -> str:
    """Name hours of a study's loads with their number: samples of its load profiles, or parts of a standard day."""
    table = study.scenario.load_profiles.file
    if table is None:
        return f"{n} quarters of an hour of a standard day"
    plural, name = "s" * (n != 1), Path(table.label).name
    kind = f"hour{plural}" if table.step_s == 3600.0 else f"sample{plural} of {table.step_s:g} s"
    return f"{n} {kind} of {name}"


def windows_text(study: Study, windows: Windows) -> str:
    """Describe in a sentence which hours the windows of a study are from."""
    added = [i for i, reason in enumerate(windows.reasons) if reason]
    if windows.hours is None:
        return f"Windows: {windows.sampled} at nominal load with noise, and {len(added)} without noise."
    hours = hours_text(study, windows.considered)
    named = [f"{time_text(study.scenario, windows.hours[i])} ({windows.reasons[i]})" for i in added[:_SHOWN]]
    named += [f"{len(added) - _SHOWN} more"] * (len(added) > _SHOWN)
    return (
        f"Windows: {windows.sampled}, spread over all {hours}, and {len(added)} at the worst of "
        f"them by a power flow of each, without noise: {', '.join(named)}."
    )


def load_hours(study: Study) -> LoadHours:
    """Find the hours that can limit a site of a study, by a power flow of every hour without it.

    Existing data centres draw their rating, and nothing is controlled except equipment of the feeder, which has
    settled. The result is kept on the study, also where that is sent to another process.
    """
    if _CACHE not in study.__dict__:
        study.__dict__[_CACHE] = _find_hours(study)
    return study.__dict__[_CACHE]


def with_same_hours(study: Study, **changes: Any) -> Study:
    """Return a study with other fields and sizes as before, to which the hours of this one apply."""
    other = dataclasses.replace(study, **{"tolerance_mw": study.step_mw, "max_mw": study.largest_mw} | changes)
    other.__dict__[_CACHE] = load_hours(study)
    return other


def sampled_windows(study: Study) -> Windows:
    """Return the windows of sampled load alone, spread evenly over all hours."""
    n = study.samples
    if study.load == "peak":
        return Windows(None, None, ("",) * n, 0)
    if study.scenario.load_profiles.file is None:
        hours = (PEAK_HOUR + 24.0 * np.arange(n) / n) % 24.0
        return Windows(hours, hours, ("",) * n, 0)
    low, high = profile_begins_h(_window_scenario(study)).T
    ends = np.cumsum(high - low)
    part = (np.arange(n) + _GOLDEN * np.arange(1, n + 1) % 1.0) / n
    if ends[-1] > 0.0:
        chosen = np.searchsorted(ends, part * ends[-1], side="right")
        hours = high[chosen] - (ends[chosen] - part * ends[-1])
    else:
        hours = low[(part * len(low)).astype(np.int64)]
    return Windows(hours, hours, ("",) * n, 0)


def with_worst_hours(study: Study, limiting: Mapping[float, str]) -> Windows:
    """Return the sampled windows of a study, and windows at its worst hours.

    Parameters
    ----------
    study
        The study.
    limiting
        Reasons for further hours by their time, h, such as those that limit the site at a bus.
    """
    sampled, extremes = sampled_windows(study), load_hours(study)
    reasons = {float(extremes.hours[i]): extremes.reasons[i] for i in extremes.named()}
    for hour, reason in limiting.items():
        reasons.setdefault(hour, reason)
    every = (*sampled.reasons, *reasons.values())
    if sampled.begin_h is None or sampled.hours is None:
        return Windows(None, None, every, 0)
    hours = np.array(list(reasons))
    begin_h = np.concatenate((sampled.begin_h, window_begins(study, hours)))
    return Windows(begin_h, np.concatenate((sampled.hours, hours)), every, len(extremes.every))


def window_begins(study: Study, hours: np.ndarray) -> np.ndarray:
    """Return the begins of windows whose sites draw their rating while the load is that of some hours, h, (hour,)."""
    profiles = study.scenario.load_profiles
    if profiles.file is None:
        return hours % 24.0
    step_s, holds = profiles.file.step_s, profiles.between == "hold"
    begin_s = 3600.0 * hours
    if not holds or step_s < study.window_s:
        begin_s = begin_s + (0.5 * step_s if holds else 0.0) - 0.5 * sum(study.full_load_s)
    low, high = profile_begins_h(_window_scenario(study)).T
    return np.clip(begin_s / 3600.0, low.min(), high.max())


def _window_scenario(study: Study) -> Scenario:
    return with_sites(study, free_bus(study), (0.0,), **study.window_fields)


def _find_hours(study: Study) -> LoadHours:
    if study.load == "peak":
        return LoadHours(np.zeros(1), ("nominal load",), np.zeros(1), np.empty(0))
    fields = study.window_fields | {"workload.full_load_s": None, "horizon": 2} | still_fields(study)
    scenario = with_sites(study, free_bus(study), (0.0,), **fields)
    hours = _sample_hours(scenario)
    lowest, highest, loaded = _Extremes(_RANKS, -1.0), _Extremes(1, 1.0), _Extremes(_RANKS, 1.0)
    load_kw, unsolved = np.zeros(len(hours)), np.zeros(len(hours), bool)
    rated = rating_coverage(scenario.feeder).known > 0
    at_once = max(1, _VALUES // (scenario.feeder.n_node * 8))
    driven = as_driven(scenario, NoControl())
    for first in range(0, len(hours), at_once):
        rows = np.arange(first, min(first + at_once, len(hours)))
        begin_h = hours[rows]
        if scenario.load_profiles.file is None:
            load_kw[rows] = load_share(begin_h)
        else:
            load_kw[rows] = profile_loads(scenario, begin_h)[0].sum(axis=1)
        steps = transitions(driven, NoControl(), [0] * len(rows), None, {"begin_h": begin_h})
        now = next(steps)
        steps.close()
        solved = np.asarray(now.converged)
        unsolved[rows] = ~solved
        v_pu = now.state.v_pu[solved][:, scenario.feeder.load_slice]
        lowest.add(v_pu, rows[solved])
        highest.add(v_pu, rows[solved])
        if rated:
            loaded.add(now.state.loading[solved], rows[solved])
    named: dict[int, list[str]] = {int(load_kw.argmax()): ["highest load"]}
    if unsolved.any():
        named.setdefault(int(unsolved.argmax()), []).append("no power-flow solution")
    for reason, extremes in (("lowest voltage", lowest), ("highest voltage", highest), ("highest loading", loaded)):
        if (hour := extremes.first()) is not None:
            named.setdefault(hour, []).append(reason)
    order = list(dict.fromkeys([*named, *lowest.in_order(), *loaded.in_order()]))
    kept = order[:MOST_HOURS]
    reasons = tuple(", ".join(named.get(i, ())) for i in kept)
    return LoadHours(hours[kept], reasons, hours, loaded.largest())


def _sample_hours(scenario: Scenario) -> np.ndarray:
    """Times of the samples of load in which episodes of a scenario may lie, h, (sample,)."""
    table = scenario.load_profiles.file
    if table is None:
        return (PEAK_HOUR + 0.25 * np.arange(96)) % 24.0
    hours = table.begin_h + table.step_s / 3600.0 * np.arange(len(table.values))
    start = scenario.load_profiles.start_h
    return hours if start is None else np.array([start])


class _Extremes:
    """The most extreme values of each node or branch so far, and their hours."""

    def __init__(self, ranks: int, sign: float):
        self._ranks, self._sign = ranks, sign
        self._values, self._hours = np.empty((0, 0)), np.empty((0, 0), np.int64)

    def add(self, values: np.ndarray, hours: np.ndarray) -> None:
        """Take the values of some hours, (hour, node)."""
        if not len(values):
            return
        values, hours = np.round(self._sign * values, _DIGITS), np.broadcast_to(hours[:, None], values.shape)
        if len(self._values):
            values, hours = np.concatenate((self._values, values)), np.concatenate((self._hours, hours))
        best = np.argsort(-values, axis=0, kind="stable")[: self._ranks]
        self._values, self._hours = np.take_along_axis(values, best, 0), np.take_along_axis(hours, best, 0)

    def largest(self) -> np.ndarray:
        """Return the most extreme value of each, times the sign; empty without any."""
        return self._values[0] if self._values.size else np.empty(0)

    def first(self) -> int | None:
        """Return the hour of the most extreme value of all; None without any."""
        return int(self._hours[0, self._values[0].argmax()]) if self._values.size else None

    def in_order(self) -> list[int]:
        """Return the hours by rank, and within a rank by value."""
        order: list[int] = []
        for values, hours in zip(self._values, self._hours, strict=True):
            order += hours[np.argsort(-values, kind="stable")].tolist()
        return order

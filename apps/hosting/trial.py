"""Run sites of one size at several buses in several samples as one batch, and measure the margins to the limits."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np

from dcgrid_env import Feeder, FeederError, rating_coverage
from dcgrid_env.apps.hosting.added_site import AddedSite
from dcgrid_env.apps.hosting.element_names import branch_to
from dcgrid_env.apps.hosting.load_hours import load_hours
from dcgrid_env.baselines.controller import Controller
from dcgrid_env.baselines.laws.no_control import NoControl
from dcgrid_env.baselines.rollout import as_driven, transitions
from dcgrid_env.powerflow import n_loading

COLLAPSED = -10.0
"""Margin if the power flow has no solution."""
UNLIMITED = 1e6
"""Margin without a limit, for example of branches without a known rating."""
ROUNDING = 1e-9
"""Margin below 0 that breaks no limit."""
_VALUES = 4_000_000
"""Maximum number of voltages of a batch that are stored at a time; larger batches run in parts."""
LIMITS = ("undervoltage", "overvoltage", "overload", "voltage step", "taps", "loss")
UNDERVOLTAGE, _, OVERLOAD, _, TAPS, LOSS = range(len(LIMITS))


class Trial(NamedTuple):
    """Results of a batch, by environment."""

    margins: np.ndarray
    """Least margin to each of ``LIMITS`` over the seconds that count, negative beyond the limit, (row, limit). A
    voltage margin is a share of half the width of the voltage limits, the others are shares of their limit. Taps and
    loss are those of the whole window. All are ``COLLAPSED`` without a power-flow solution, and ``UNLIMITED`` for
    limits that the study does not have."""
    nodes: np.ndarray
    """Location of each margin as a position in ``node_ids``, of an overload in ``State.loading``, of taps the row of
    the regulator, (row, limit)."""
    outside: np.ndarray
    """Number of steps that count in which some limit was broken, int, (row,)."""
    arrived_kw: np.ndarray
    """Dynamic power demand of the added site's arriving work in each step, kW, (row, step)."""
    served_kw: np.ndarray
    """Dynamic power of the added site's served work in each step, kW, (row, step)."""

    @property
    def margin(self) -> float:
        """Least margin of any environment to any limit."""
        return float(self.margins.min())

    def select(self, env_indices: np.ndarray | slice) -> Trial:
        """Select some of the environments."""
        return Trial(*(part[env_indices] for part in self))

    @classmethod
    def joined(cls, parts: list[Trial]) -> Trial:
        """Concatenate the environments of several trials."""
        return cls(*(np.concatenate(part) for part in zip(*parts, strict=True)))


def run_trial(
    site: AddedSite, controller: Controller, size: int, buses: np.ndarray, samples: np.ndarray, name: str
) -> Trial:
    """Run sites of one size; ``buses`` are positions in ``bus_ids``, ``samples`` numbers of windows, (row,) each.

    The result of an environment does not depend on the rest of the batch. Raises ControllerError if the controller
    fails or refuses the scenario.
    """
    at_once = max(1, _VALUES // (site.study.scenario.feeder.n_node * 8))
    still = site.windows.still[samples]
    rows = [np.flatnonzero(still == quiet) for quiet in (False, True)]
    parts = [part[a : a + at_once] for part in rows for a in range(0, len(part), at_once)]
    joined = Trial.joined([_run(site, controller, size, buses[part], samples[part], name) for part in parts])
    return joined.select(np.argsort(np.concatenate(parts), kind="stable"))


def trials(
    site: AddedSite, controller: Controller, size: int, bus_samples: Sequence[tuple[int, np.ndarray]], name: str
) -> list[Trial]:
    """Run a size at several buses as one batch, with separate samples for each bus."""
    buses = np.concatenate([np.full(len(samples), bus) for bus, samples in bus_samples])
    trial = run_trial(site, controller, size, buses, np.concatenate([samples for _, samples in bus_samples]), name)
    ends = np.cumsum([0, *(len(samples) for _, samples in bus_samples)])
    return [trial.select(slice(a, b)) for a, b in pairwise(ends)]


def overloaded_nodes(site: AddedSite) -> np.ndarray:
    """Find branches that are overloaded without any site or control in more steps than allowed, or in any hour.

    Returns
    -------
    np.ndarray
        For each position in the loading, bool.

    Raises
    ------
    FeederError
        For such a branch of a feeder with loops, where the buses that it limits are not those behind it.
    """
    study, controller, still = site.study, NoControl(), site.windows.still
    feeder = study.scenario.feeder
    seconds = np.zeros(n_loading(feeder), np.int64)
    if not rating_coverage(feeder).known:
        return seconds > 0
    for quiet in np.unique(still).tolist():
        samples = np.flatnonzero(still == quiet)
        seeds, options = site.reset_arguments(np.ones_like(samples), samples)
        steps = transitions(as_driven(site.scenario(0, quiet), controller), controller, seeds, None, options)
        next(steps)
        for k in range(study.horizon):
            loading = next(steps).state.loading
            if k >= study.settled:
                seconds += (loading > study.loading_max_pct / 100.0 + ROUNDING).sum(axis=0)
        steps.close()
    overloaded = seconds > study.allowed_seconds(len(still))
    if not study.allowed_pct and len(most := load_hours(study).loading):
        overloaded |= most > study.loading_max_pct / 100.0 + ROUNDING
    if overloaded.any() and isinstance(feeder, Feeder) and feeder.n_loop:
        raise FeederError(
            f"feeder {feeder.name!r} has loops, and its {branch_to(feeder, int(overloaded.argmax()))} is overloaded "
            "without any site, so the buses that it limits are undefined; raise its rating_a or open the loops"
        )
    return overloaded


def hour_margins(site: AddedSite, size: Any, bus: int) -> np.ndarray:
    """Return the margins to each of ``LIMITS`` in a power flow of each window's begin, (window, limit).

    The data centres draw what they do at the begin, and nothing is controlled except equipment of the feeder, which has
    settled. Changes from step to step and taps do not count.
    """
    study, parts = site.study, []
    at_once = max(1, _VALUES // (study.scenario.feeder.n_node * 8))
    scenario = as_driven(site.scenario(size, True), NoControl())
    for first in range(0, len(site.windows), at_once):
        samples = np.arange(first, min(first + at_once, len(site.windows)))
        seeds, options = site.reset_arguments(np.full_like(samples, bus), samples)
        steps = transitions(scenario, NoControl(), seeds, None, options)
        now = next(steps)
        steps.close()
        margins, _ = _distances(site, now, None)
        if study.loss_max_kw is not None:
            margins[:, LOSS] = 1.0 - now.loss_kw / study.loss_max_kw
        margins[~np.asarray(now.converged)] = COLLAPSED
        parts.append(margins)
    return np.concatenate(parts)


def _run(
    site: AddedSite, controller: Controller, size: int, buses: np.ndarray, samples: np.ndarray, name: str
) -> Trial:
    study, n_env = site.study, len(buses)
    scenario = as_driven(site.scenario(size, bool(site.windows.still[samples[0]])), controller)
    seeds, options = site.reset_arguments(buses, samples)
    steps = transitions(scenario, controller, seeds, name, options)
    next(steps)
    margins, nodes = np.full((n_env, len(LIMITS)), UNLIMITED), np.zeros((n_env, len(LIMITS)), np.int64)
    outside, goes_on = np.zeros(n_env, np.int64), np.ones(n_env, bool)
    arrived, served = (np.zeros((n_env, study.horizon)) for _ in range(2))
    loss_kw, taps, before = np.zeros(n_env), np.zeros((n_env, 1)), None
    for k in range(study.horizon):
        now = next(steps)
        arrived[:, k], served[:, k] = now.state.arrived_kw[:, site.slot], now.state.served_kw[:, site.slot]
        if k >= study.settled:
            now_margins, where = _distances(site, now, before)
            loss_kw = loss_kw + now.loss_kw
            if study.taps_max_per_hour is not None:
                taps = taps + now.state.three_phase.equipment.regulators.moved
            outside += (now_margins < -ROUNDING).any(axis=1)
            nearer = now_margins < margins
            margins, nodes = np.where(nearer, now_margins, margins), np.where(nearer, where, nodes)
        before = now.state.v_pu
        lost = goes_on & ~np.asarray(now.converged)
        if lost.any():
            goes_on &= ~lost
            if not goes_on.any():
                break
    steps.close()
    counted = study.horizon - study.settled
    if study.taps_max_per_hour is not None:
        hours = counted * scenario.dt_s / 3600.0
        margins[:, TAPS] = 1.0 - taps.max(axis=1) / (study.taps_max_per_hour * hours)
        nodes[:, TAPS] = taps.argmax(axis=1)
    if study.loss_max_kw is not None:
        margins[:, LOSS] = 1.0 - loss_kw / (study.loss_max_kw * counted)
    outside[(margins[:, [TAPS, LOSS]] < -ROUNDING).any(axis=1)] = counted
    # What follows a power flow without a solution is another episode, and does not count.
    margins[~goes_on] = COLLAPSED
    outside[~goes_on] = counted
    return Trial(margins, nodes, outside, arrived, served)


def _distances(site: AddedSite, now: Any, before: np.ndarray | None) -> tuple[np.ndarray, np.ndarray]:
    """Each trial's distance to each limit now, and where, (row, limit) each; ``before`` are the voltages before."""
    study, nodes = site.study, site.study.scenario.feeder.load_slice
    v = now.state.v_pu[:, nodes]
    row, half = np.arange(len(v)), 0.5 * (study.v_max_pu - study.v_min_pu)
    lowest, highest = v.argmin(axis=1), v.argmax(axis=1)
    below, above = (v[row, lowest] - study.v_min_pu) / half, (study.v_max_pu - v[row, highest]) / half
    first = nodes.start or 0
    loaded, branch = np.full(len(v), UNLIMITED), np.zeros(len(v), np.int64)
    if now.state.loading is not None:  # 0 where no rating is known
        loading = np.where(site.exempt, 0.0, now.state.loading)
        branch = loading.argmax(axis=1)
        loaded = 1.0 - loading[row, branch] / (study.loading_max_pct / 100.0)
    unlimited, nowhere = np.full(len(v), UNLIMITED), np.zeros(len(v), np.int64)
    stepped, at_step = unlimited, nowhere
    if study.voltage_step_max_pct is not None and before is not None:
        change = np.abs(v - before[:, nodes])
        at_step = change.argmax(axis=1)
        stepped, at_step = 1.0 - change[row, at_step] / (study.voltage_step_max_pct / 100.0), at_step + first
    where = (lowest + first, highest + first, branch, at_step, nowhere, nowhere)
    return np.stack((below, above, loaded, stepped, unlimited, unlimited), axis=1), np.stack(where, axis=1)

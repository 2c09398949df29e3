"""Sites of one size at several buses, in several samples, as one batch: how near they bring the feeder to its limits."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from dcgrid_env.baselines.controller import Controller
from dcgrid_env.baselines.hosting_capacity.added_site import AddedSite
from dcgrid_env.baselines.rollout import as_driven, transitions

COLLAPSED = -10.0
"""Margin where the power flow has no solution."""
_ROUNDING = 1e-9
_VALUES = 4_000_000
"""Voltages of a batch that are kept at a time: larger ones run in parts."""
LIMITS = ("undervoltage", "overvoltage", "overload", "no power flow solution")
UNDERVOLTAGE, OVERVOLTAGE, OVERLOAD, NO_SOLUTION = range(4)


class Trial(NamedTuple):
    """What a batch came to, by lane."""

    margin: np.ndarray
    """Least distance to a limit over the seconds that count, negative beyond it, (lane,): of a voltage as a share of
    half the width between its limits, of a current as a share of its own."""
    limit: np.ndarray
    """Which of ``LIMITS`` that is, int, (lane,)."""
    at: np.ndarray
    """Where: position in ``node_ids``, or of the branch of an overload, int, (lane,)."""
    outside: np.ndarray
    """Steps that count in which some limit was broken, int, (lane,)."""
    arrived_kw: np.ndarray
    """Dynamic power that the added site's arriving work asked for in each step, kW, (lane, step)."""
    served_kw: np.ndarray
    """The same of work served."""

    def of(self, lanes: Any) -> Trial:
        """Some of the lanes."""
        return Trial(*(part[lanes] for part in self))

    @classmethod
    def joined(cls, parts: list[Trial]) -> Trial:
        """The lanes of several, one after the other."""
        return cls(*(np.concatenate(part) for part in zip(*parts, strict=True)))


def run_trial(
    site: AddedSite, controller: Controller, size: int, buses: np.ndarray, samples: np.ndarray, name: str
) -> Trial:
    """Run sites of a size; ``buses`` are positions in ``bus_ids`` and ``samples`` numbers, (lane,) each.

    A lane comes to the same whatever stands beside it. ControllerError where the controller fails or refuses.
    """
    at_once = max(1, _VALUES // (site.study.scenario.feeder.n_node * 8))
    parts = [slice(a, a + at_once) for a in range(0, len(buses), at_once)]
    return Trial.joined([_run(site, controller, size, buses[part], samples[part], name) for part in parts])


def _run(
    site: AddedSite, controller: Controller, size: int, buses: np.ndarray, samples: np.ndarray, name: str
) -> Trial:
    study, lanes = site.study, len(buses)
    scenario = as_driven(site.scenario(size), controller)
    seeds, options = site.lanes(buses, samples)
    steps = transitions(scenario, controller, seeds, name, options)
    next(steps)
    margin, outside = np.full(lanes, np.inf), np.zeros(lanes, np.int64)
    limit, at = np.zeros(lanes, np.int64), np.zeros(lanes, np.int64)
    arrived, served = (np.zeros((lanes, study.horizon)) for _ in range(2))
    goes_on = np.ones(lanes, bool)
    for k in range(study.horizon):
        now = next(steps)
        solved = np.asarray(now.converged)
        arrived[:, k] = np.where(goes_on, now.state.arrived_kw[:, site.slot], 0.0)
        served[:, k] = np.where(goes_on & solved, now.state.served_kw[:, site.slot], 0.0)
        if k >= study.settled:
            here, kind, where = _distances(site, now)
            outside += goes_on & solved & (here < -_ROUNDING)
            nearer = goes_on & solved & (here < margin)
            margin, limit, at = (np.where(nearer, a, b) for a, b in ((here, margin), (kind, limit), (where, at)))
        lost = goes_on & ~solved
        if lost.any():  # what follows is another episode: the rest of this one is all outside
            margin[lost], limit[lost] = COLLAPSED, NO_SOLUTION
            outside[lost] += study.horizon - max(k, study.settled)
            goes_on &= ~lost
    steps.close()
    return Trial(margin, limit, at, outside, arrived, served)


def _distances(site: AddedSite, now: Any) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Each lane's least distance to a limit now, which limit that is, and where, (lane,) each."""
    study, nodes = site.study, site.study.scenario.feeder.load_slice
    v = now.state.v_pu[:, nodes]
    lane, half = np.arange(len(v)), 0.5 * (study.v_max_pu - study.v_min_pu)
    lowest, highest = v.argmin(axis=1), v.argmax(axis=1)
    below, above = (v[lane, lowest] - study.v_min_pu) / half, (study.v_max_pu - v[lane, highest]) / half
    under = below <= above
    margin, kind = np.where(under, below, above), np.where(under, UNDERVOLTAGE, OVERVOLTAGE)
    return margin, kind, np.where(under, lowest, highest) + (nodes.start or 0)

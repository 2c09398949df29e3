"""A random feeder as it is drawn: tree, loads, conductors and lengths, drawn again until it can be run."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from dcgrid_env.grid.random_feeders.conductors import Conductor
from dcgrid_env.grid.random_feeders.draws import Draws
from dcgrid_env.grid.random_feeders.styles import Style
from dcgrid_env.grid.random_feeders.tree import Tree, draw_tree
from dcgrid_env.grid.topology import FeederError

LARGEST_REACH_PU = 1.5
"""What no R_ii and no X_ii exceeds, times the sum of the loads, p.u."""
HEADROOM = 2.0
"""Times the loads at which a feeder still has a power flow."""
LOWEST_PU = 0.7
"""Voltage that no bus is below at that load, where the substation is at 1 p.u."""
MOST_STRETCH = 3.0
"""Factor by which lengths are stretched or shortened at most to meet the drop."""
LARGEST_LOADING = 0.9
"""Current as a share of the ampacity at most, where even the largest conductor is loaded beyond its utilisation."""
SMALLEST_DROP_PU = 1e-9
"""Least drop that lengths are stretched from: no load may stand where the voltage falls."""
WHOLE_DROP_AT = 40
"""Buses from which on feeders have the whole drop of their style; smaller ones have less, and less load."""
ATTEMPTS = 200
_SWEEPS = 30
_SETTLED_PU = 1e-9


class DrawnFeeder(NamedTuple):
    """Figures of a feeder by bus, the substation first, and by branch; branch k feeds bus k + 1."""

    tree: Tree
    v0_pu: float
    p_kw: np.ndarray
    q_kvar: np.ndarray
    length_km: np.ndarray
    conductor: tuple[Conductor, ...]
    """That of each branch."""
    drop_pu: float
    """Difference between the substation, at 1 p.u., and the lowest bus, p.u."""
    attempts: int

    @property
    def r_ohm(self) -> np.ndarray:
        """Series resistance of each branch, ohm."""
        return self.length_km * np.array([c.r_ohm_per_km for c in self.conductor])

    @property
    def x_ohm(self) -> np.ndarray:
        """Series reactance of each branch, ohm."""
        return self.length_km * np.array([c.x_ohm_per_km for c in self.conductor])

    @property
    def ampacity_a(self) -> np.ndarray:
        """Ampacity of each branch, A."""
        return np.array([c.ampacity_a for c in self.conductor])


def draw_feeder(seed: int, n_bus: int, style: Style, load_kw: float | None) -> DrawnFeeder:
    """Draw a feeder; a draw that cannot be used is repeated.

    Raises FeederError if no attempt succeeds: feeders of the style do not carry such a load.
    """
    for attempt in range(ATTEMPTS):
        drawn = _attempt(Draws(seed, attempt), n_bus, style, load_kw)
        if drawn is not None:
            return drawn._replace(attempts=attempt + 1)
    raise FeederError(
        f"random feeder: none of {n_bus} buses in this style carries {load_kw or 0:g} kW within {ATTEMPTS} attempts; "
        "give another load_kw, or leave it out"
    )


def _attempt(draws: Draws, n_bus: int, style: Style, load_kw: float | None) -> DrawnFeeder | None:
    """One attempt; None for a feeder that no conductor carries, or whose drop or headroom is not met."""
    tree = draw_tree(draws, style, n_bus)
    p_kw, q_kvar = _loads(draws, style, tree, load_kw)
    conductor = _conductors(draws, style, tree, p_kw, q_kvar)
    finer = min(1.0, style.whole_at / n_bus) ** 0.5
    median_m = draws.between(style.length_m) * finer
    length_km = 1e-3 * median_m * np.exp(style.length_sigma * draws.standard(n_bus - 1))
    v0_pu = round(draws.between(style.v0_pu), 3)
    wanted = draws.between(style.drop_pu) * min(1.0, n_bus / WHOLE_DROP_AT) ** 0.5
    if conductor is None:
        return None
    each = 1.0 / style.base_kv**2 / 1e3  # p.u. of ohm and kW
    per_km = np.array([(c.r_ohm_per_km, c.x_ohm_per_km) for c in conductor]).T * each
    stretch = _stretch(tree, per_km * length_km, p_kw[1:], q_kvar[1:], wanted)
    if stretch is None:
        return None
    length_km = np.maximum(np.round(length_km * stretch, 4), 1e-3)
    r, x = per_km * length_km
    drop = _drop(tree, r, x, p_kw[1:], q_kvar[1:])
    most = _drop(tree, r, x, HEADROOM * p_kw[1:], HEADROOM * q_kvar[1:])
    reach = max(tree.along(r).max(), tree.along(x).max()) * p_kw.sum()
    if drop is None or most is None or most > 1.0 - LOWEST_PU or reach > 0.95 * LARGEST_REACH_PU:
        return None
    return DrawnFeeder(tree, v0_pu, p_kw, q_kvar, length_km, conductor, drop, 0)


def _loads(draws: Draws, style: Style, tree: Tree, load_kw: float | None) -> tuple[np.ndarray, np.ndarray]:
    """Active and reactive load of each bus; ends have one first of all."""
    n = len(tree.parent)
    n_loaded = max(style.n_loaded(n + 1), round(draws.between(style.loaded_share) * n))
    first = np.argsort(draws.bits(n) >> np.uint64(1) | (~tree.ends).astype(np.uint64) << np.uint64(63), kind="stable")
    loaded = np.sort(first[:n_loaded])
    weight = np.exp(draws.between(style.load_sigma) * draws.standard(n))[loaded]
    total_kw = draws.between(style.mean_kw) * n_loaded * min(1.0, style.whole_at / (n + 1))
    total_kw = total_kw if load_kw is None else load_kw
    p_kw, q_kvar = np.zeros(n + 1), np.zeros(n + 1)
    p_kw[1 + loaded] = _digits(weight * (total_kw / weight.sum()))
    middle = draws.between(style.power_factor)
    factor = np.clip(middle + 0.02 * (draws.uniform(n)[loaded] - 0.5), 0.5, 0.999)
    q_kvar[1 + loaded] = _digits(p_kw[1 + loaded] * np.sqrt(1.0 - factor**2) / factor)
    return p_kw, q_kvar


def _conductors(
    draws: Draws, style: Style, tree: Tree, p_kw: np.ndarray, q_kvar: np.ndarray
) -> tuple[Conductor, ...] | None:
    """Return for each branch the smallest sufficient conductor of its chain's family; None if none carries the load.

    The load of branches grows towards the substation, and so do conductors. No conductor has less ampacity than one
    that it feeds, except for the largest of a family.
    """
    flow_kva = np.hypot(tree.downstream(p_kw[1:]), tree.downstream(q_kvar[1:]))
    utilisation = draws.between(style.utilisation)
    least_a = flow_kva / (np.sqrt(3.0) * style.base_kv) / utilisation
    shares = np.cumsum([share for share, _ in style.conductors])
    of_chain = np.searchsorted(shares, draws.uniform(tree.n_chain) * shares[-1], side="right")
    chosen: list[Conductor] = []
    fed_a = np.zeros(len(least_a) + 1)  # largest ampacity that leaves each bus
    for branch in range(len(least_a) - 1, -1, -1):
        needed_a, family = float(least_a[branch]), style.conductors[of_chain[tree.chain[branch]]][1]
        fits = [conductor for conductor in family if conductor.ampacity_a >= needed_a]
        if not fits and least_a[branch] * utilisation > LARGEST_LOADING * family[-1].ampacity_a:
            return None
        fits = [conductor for conductor in fits if conductor.ampacity_a >= fed_a[branch + 1]]
        chosen.append(fits[0] if fits else family[-1])
        fed_a[tree.parent[branch]] = max(fed_a[tree.parent[branch]], chosen[-1].ampacity_a)
    return tuple(reversed(chosen))


def _stretch(tree: Tree, impedance: np.ndarray, p_kw: np.ndarray, q_kvar: np.ndarray, wanted: float) -> float | None:
    """Factor of all lengths at which the drop is as wanted; None where it is too large or too small for that."""
    factor = 1.0
    for _ in range(4):
        r, x = factor * impedance
        drop = _drop(tree, r, x, p_kw, q_kvar)
        factor *= 0.5 if drop is None else min(max(wanted / max(drop, SMALLEST_DROP_PU), 0.2), 5.0)
    return factor if 1.0 / MOST_STRETCH <= factor <= MOST_STRETCH else None


def _drop(tree: Tree, r: np.ndarray, x: np.ndarray, p_kw: np.ndarray, q_kvar: np.ndarray) -> float | None:
    """Difference between the substation, at 1 p.u., and the lowest bus; None where the power flow does not settle.

    The branch flow equations of M. E. Baran and F. F. Wu, swept until voltages stay; ``r`` and ``x`` are in p.u. of
    voltage a kW and kvar.
    """
    square, before = np.ones(len(p_kw)), np.ones(len(p_kw))
    loss = np.zeros(len(p_kw))
    for _ in range(_SWEEPS):
        p, q = (tree.downstream(load + z * loss) for load, z in ((p_kw, r), (q_kvar, x)))
        sending = np.where(tree.parent > 0, square[tree.parent - 1], 1.0)
        loss = (p**2 + q**2) / sending
        square = 1.0 - tree.along(2.0 * (r * p + x * q) - (r**2 + x**2) * loss)
        if not square.min() > 0.1:
            return None
        if np.abs(square - before).max() < _SETTLED_PU:
            return float(1.0 - np.sqrt(square.min()))
        before = square
    return None


def _digits(values: np.ndarray) -> np.ndarray:
    """To four significant digits, in which the last bits of a machine's exponential do not show."""
    return np.array([float(f"{value:.4g}") for value in values])

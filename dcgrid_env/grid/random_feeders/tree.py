"""The tree of a random feeder: departures from the substation, and laterals off them and off each other.

Chains of buses are added one after the other. The style's number of departures begin at the substation, and the first
of these has the style's length. Every other chain begins at a bus drawn among those that are passed through. Every
chain therefore has one end, and the number of ends is drawn explicitly. The time is linear in the number of buses.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from dcgrid_env.grid.random_feeders.draws import Draws
from dcgrid_env.grid.random_feeders.styles import Style

MOST_CHILDREN = 3
"""Branches that leave a bus other than the substation at most."""


class Tree(NamedTuple):
    """A tree in depth-first order, bus 0 being the substation; branch k feeds bus k + 1."""

    parent: np.ndarray
    """Bus that feeds branch k, int, (n_branch,)."""
    chain: np.ndarray
    """Chain that branch k belongs to, int, (n_branch,); the first ones are departures."""
    n_chain: int
    levels: list[np.ndarray]
    """Branches by their distance from the substation, the nearest first."""

    @property
    def ends(self) -> np.ndarray:
        """Whether nothing leaves bus k + 1, bool, (n_branch,)."""
        return np.bincount(self.parent, minlength=len(self.parent) + 1)[1:] == 0

    def downstream(self, values: np.ndarray) -> np.ndarray:
        """Sum of a figure of buses 1.. over all buses that a branch feeds, (n_branch,)."""
        total = values.astype(np.float64)
        for level in reversed(self.levels[1:]):
            np.add.at(total, self.parent[level] - 1, total[level])
        return total

    def along(self, values: np.ndarray) -> np.ndarray:
        """Sum of a figure of branches from the substation to each of the buses 1.., (n_branch,)."""
        total = values.astype(np.float64)
        for level in self.levels[1:]:
            total[level] += total[self.parent[level] - 1]
        return total


def draw_tree(draws: Draws, style: Style, n_bus: int) -> Tree:
    """Draw the tree of a feeder."""
    n = n_bus - 1
    n_departure = max(1, round(n / style.buses_a_departure))
    n_chain = min(n // 2 + 1, max(n_departure, round(draws.between(style.leaf_share) * n)))
    lengths = _lengths(draws, n, n_chain, n_departure, draws.between(style.trunk) * np.sqrt(n_bus))
    bits = draws.bits(n_chain)
    parent, chain, passed = [], [], []
    children = np.zeros(n_bus, np.intp)
    for k, length in enumerate(lengths.tolist()):
        begin = 0
        if k >= n_departure and passed:
            place = int(bits[k]) % len(passed)
            while children[passed[place]] >= MOST_CHILDREN:
                place = (place + 1) % len(passed)
            begin = passed[place]
        for _ in range(length):
            parent.append(begin)
            chain.append(k)
            children[begin] += 1
            begin = len(parent)
        passed += range(begin - length + 1, begin)
    return _depth_first(parent, chain, n_chain)


def _lengths(draws: Draws, n: int, n_chain: int, n_departure: int, trunk: float) -> np.ndarray:
    """Buses of each chain, at least one: of the first the trunk, of the others what is left in uneven parts."""
    if n_chain == 1:
        return np.array([n])
    first = min(max(2, round(trunk)), n - n_chain + 1)
    drawn = draws.uniform(n_chain - 1)
    weights = np.where(np.arange(1, n_chain) < n_departure, 0.5 + drawn, 0.05 + drawn**2)
    spare = n - first - (n_chain - 1)
    cuts = np.floor(np.cumsum(weights) / weights.sum() * spare + 0.5).astype(np.intp)
    cuts[-1] = spare
    return np.concatenate(([first], 1 + np.diff(cuts, prepend=0)))


def _depth_first(parent: list[int], chain: list[int], n_chain: int) -> Tree:
    """The tree with its buses renumbered depth first, in the order in which branches were laid."""
    n = len(parent) + 1
    children: list[list[int]] = [[] for _ in range(n)]
    for k, fed_by in enumerate(parent):
        children[fed_by].append(k + 1)
    order, place, depth, stack = [], np.zeros(n, np.intp), np.zeros(n, np.intp), [0]
    while stack:
        bus = stack.pop()
        place[bus] = len(order)
        order.append(bus)
        stack += reversed(children[bus])
    fed_by = place[np.array([parent[bus - 1] for bus in order[1:]], np.intp)]
    for k, bus in enumerate(fed_by.tolist()):
        depth[k + 1] = depth[bus] + 1
    by_depth = np.argsort(depth[1:], kind="stable")
    levels = np.split(by_depth, np.cumsum(np.bincount(depth[1:])[1:])[:-1])
    return Tree(fed_by, np.array([chain[bus - 1] for bus in order[1:]], np.intp), n_chain, levels)

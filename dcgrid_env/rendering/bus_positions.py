"""Positions of buses in the one-line diagram: published coordinates, or a tree without crossings."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from dcgrid_env.grid import AnyFeeder

FloatArray = NDArray[np.float64]

MOST_ARRANGED = 2000
"""Buses of the largest feeder whose branches are arranged to fill the picture; a larger one is drawn as it comes."""
_WIDTH_TO_HEIGHT = 1.35
"""Shape of the box that a tree should fill."""


def positions(feeder: AnyFeeder) -> FloatArray:
    """Return the position of each bus in a drawing, shape (n_bus, 2); distinct, finite and the same at each call.

    Published coordinates are used if the feeder has them. A bus without coordinates, or on top of another, is placed
    next to its upstream bus. If fewer than half are known, the drawing is a tree that grows to the right from the
    substation: the longest path is straight, laterals are on either side of it, and branches do not cross.
    """
    xy = np.column_stack((feeder.x, feeder.y))
    xy[~np.isfinite(xy).all(axis=1)] = np.nan
    _, first = np.unique(xy, axis=0, return_index=True)
    xy[np.setdiff1d(np.arange(feeder.n_bus), first)] = np.nan
    placed = np.isfinite(xy[:, 0])
    is_large = feeder.n_bus > MOST_ARRANGED
    if 2 * placed.sum() < feeder.n_bus or placed.sum() < 2:
        return _path_rows(feeder) if is_large else _tree(feeder)
    if placed.all():
        return xy
    return _near_the_next_upstream(feeder, xy) if is_large else _beside(feeder, xy)


def _path_rows(feeder: AnyFeeder) -> FloatArray:
    """Lay out a tree that grows to the right, each lateral on separate rows below its path, in linear time."""
    order, _, parent, end = feeder.depth_first
    column = np.zeros(len(order))
    for k in range(1, len(order)):
        column[k] = column[parent[k]] + 1.0
    row, last = np.zeros(len(order)), -1.0
    for k in range(len(order) - 1, -1, -1):  # a bus stands on the row of the first that it feeds
        last += end[k] == k + 1
        row[k] = last if end[k] == k + 1 else row[k + 1]
    xy = np.empty((len(order), 2))
    xy[order, 0] = column / max(column.max(), 1.0) * _WIDTH_TO_HEIGHT
    xy[order, 1] = row / max(row.max(), 1.0)
    return xy


def _near_the_next_upstream(feeder: AnyFeeder, xy: FloatArray) -> FloatArray:
    """Fill in missing rows around the bus that feeds them, or is fed by them, each in a different direction."""
    size = float(np.nanmax(np.ptp(xy[np.isfinite(xy[:, 0])], axis=0)))
    order, _, parent, _ = (indices.tolist() for indices in feeder.depth_first)
    golden_angle = np.pi * (3.0 - 5.0**0.5)

    def put(bus: int, beside: int, k: int) -> None:
        if np.isnan(xy[bus, 0]) and np.isfinite(xy[beside, 0]):
            reach = 1e-3 * size * (1.0 + k / len(order))
            xy[bus] = xy[beside] + reach * np.array([np.cos(k * golden_angle), np.sin(k * golden_angle)])

    for k in range(len(order) - 1, 0, -1):
        put(order[parent[k]], order[k], k)
    for k in range(1, len(order)):
        put(order[k], order[parent[k]], k)
    return xy


def _beside(feeder: AnyFeeder, xy: FloatArray) -> FloatArray:
    """Fill in missing rows near a neighbour that is placed, in the direction with the most room."""
    upstream = np.concatenate(([-1], feeder.parent))
    lengths = np.linalg.norm(xy[1:] - xy[feeder.parent], axis=1)
    reach = 0.5 * np.nanmedian(lengths) if np.isfinite(lengths).any() else 0.02 * np.nanmax(np.ptp(xy, axis=0))
    angle = 2.0 * np.pi * np.arange(16) / 16
    around = reach * np.column_stack((np.cos(angle), np.sin(angle)))
    while not np.isfinite(xy).all():
        for i in feeder.depth_first.order:
            near = [upstream[i], *(np.flatnonzero(feeder.parent == i) + 1)]
            near = [j for j in near if j >= 0 and np.isfinite(xy[j, 0])]
            if np.isfinite(xy[i, 0]) or not near:
                continue
            candidates = xy[near[0]] + around
            placed = xy[np.isfinite(xy[:, 0])]
            room = np.linalg.norm(candidates[:, None] - placed, axis=2).min(axis=1)
            xy[i] = candidates[np.argmax(np.round(room / reach, 6))]
    return xy


class _Block:
    """A path of buses on one row with its laterals above and below; rows relative to it, columns absolute."""

    def __init__(self, chain: list[int], column: int, n_columns: int):
        self.positions = {bus: (column + k, 0) for k, bus in enumerate(chain)}
        self.low = np.full(n_columns, np.inf)
        self.high = np.full(n_columns, -np.inf)
        # One column more than the path has, so that paths on the same row do not read as one.
        span = slice(column, column + len(chain) + 1)
        self.low[span] = self.high[span] = 0

    def attach(self, lateral: _Block, side: int | None) -> int:
        """Put a lateral as near as it goes, above (side 1) or mirrored below (-1), or where it comes nearer."""
        up = max(1.0, float((self.high - lateral.low).max()) + 1.0)
        down = max(1.0, float((-lateral.low - self.low).max()) + 1.0)
        if side is None:
            side = 1 if (up, self.high.max()) <= (down, -self.low.min()) else -1
        shift = int(up if side > 0 else down)
        self.positions |= {bus: (column, side * (row + shift)) for bus, (column, row) in lateral.positions.items()}
        edges = side * (lateral.low + shift), side * (lateral.high + shift)
        occupied = np.isfinite(lateral.low)
        self.low[occupied] = np.minimum(self.low, np.minimum(*edges))[occupied]
        self.high[occupied] = np.maximum(self.high, np.maximum(*edges))[occupied]
        return side


def _tree(feeder: AnyFeeder) -> FloatArray:
    children: list[list[int]] = [[] for _ in range(feeder.n_bus)]
    weight = [(1, 1)] * feeder.n_bus  # buses on the longest way down, buses in all
    for j in feeder.depth_first.order[::-1].tolist():
        below = [weight[k] for k in children[j]]
        weight[j] = (1 + max((b[0] for b in below), default=0), 1 + sum(b[1] for b in below))
        if j > 0:
            children[feeder.parent[j - 1]].append(j)

    def block(start: int, column: int, hanging: bool) -> _Block:
        chain = [start]
        while children[chain[-1]]:
            chain.append(max(children[chain[-1]], key=lambda k: (weight[k], -k)))
        result = _Block(chain, column, 2 * feeder.n_bus + 1)
        # From the far end back: a lateral nearer to the root then passes outside those beyond it.
        for k in range(len(chain) - 1, -1, -1):
            laterals = sorted((b for b in children[chain[k]] if b not in chain), key=lambda b: (weight[b], b))
            # One lateral can stand straight on either side of a bus, but not where the bus itself hangs on another;
            # any more lean to the right beneath them.
            straight = 1 if hanging and k == 0 else 2
            for bus in laterals[:-straight]:
                result.attach(block(bus, column + k + 1, False), None)
            side = 1 if straight == 1 else None
            for bus in laterals[-straight:]:
                taken = result.attach(block(bus, column + k, True), side)
                side = -taken
        return result

    positions = block(0, 0, False).positions
    xy = np.array([positions[i] for i in range(feeder.n_bus)], dtype=np.float64)
    width, height = np.maximum(np.ptp(xy, axis=0), 1.0)
    xy[:, 1] *= np.clip(width / height / _WIDTH_TO_HEIGHT, 0.3, 2.5)
    return xy

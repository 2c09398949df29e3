"""Convert a list of branches to an indexed tree rooted at the substation and the branches that close loops."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray


class FeederError(ValueError):
    """A feeder whose data cannot be used; the message names the buses, branches and fields."""


MOST_LOOPS = 8
"""Loops of a balanced feeder that its power flow solves, see ``powerflow.balanced.looped``."""
_MOST_LISTED = 200
"""Buses that a message lists; of more it shows the first few."""


def listed(buses: Sequence[Any]) -> str:
    """Buses as a message lists them, of very many the first ten and how many there are."""
    if len(buses) <= _MOST_LISTED:
        return str(list(buses))
    return f"{str(list(buses[:10]))[:-1]}, ..] ({len(buses):,} in all)"


class DepthFirst(NamedTuple):
    """A tree in depth-first order from its root, so that every subtree is one slice of the order; shape (n_bus,) each.

    A *place* is a position in that order. Place 0 is the root's.
    """

    order: NDArray[np.intp]
    """Bus at each place."""
    place: NDArray[np.intp]
    """Place of each bus."""
    parent: NDArray[np.intp]
    """Place that feeds each place; the root is said to feed itself."""
    end: NDArray[np.intp]
    """Place after the last of the subtree that begins at each place."""


def depth_first(parent: Sequence[int] | NDArray[np.intp]) -> DepthFirst:
    """Index the tree whose bus k + 1 is fed by bus ``parent[k]`` and whose root is bus 0; read-only arrays."""
    n = len(parent) + 1
    children: list[list[int]] = [[] for _ in range(n)]
    for k, i in enumerate(parent):
        children[i].append(k + 1)
    visited, stack = [], [0]
    while stack:
        i = stack.pop()
        visited.append(i)
        stack.extend(reversed(children[i]))
    order = np.array(visited, dtype=np.intp)
    place = np.empty_like(order)
    place[order] = np.arange(n)
    fed_from = np.zeros_like(order)
    fed_from[1:] = place[np.asarray(parent, dtype=np.intp)[order[1:] - 1]]
    end = np.arange(1, n + 1, dtype=np.intp)
    for k in range(n - 1, 0, -1):
        end[fed_from[k]] = max(end[fed_from[k]], end[k])
    index = DepthFirst(order, place, fed_from, end)
    for array in index:
        array.flags.writeable = False
    return index


def orient(
    name: str, substation: object, bus_ids: Sequence[Any], from_bus: Sequence[Any], to_bus: Sequence[Any]
) -> tuple[NDArray[np.intp], list[int], NDArray[np.intp], list[tuple[int, int]]]:
    """Order buses with the substation first and give every bus its feeding branch.

    Returns
    -------
    order
        Row of each bus in the given table, shape (n_bus,).
    parent
        For branch k of the tree, which feeds bus k + 1 of that order, the index in that order of the bus that feeds it.
    branch
        For branch k, its row in the given table: those of the tree, then those that close a loop each.
    loop_ends
        For each branch that closes a loop, the indices in that order of its sending and its receiving bus.

    Raises
    ------
    FeederError
        For a duplicate, unknown or isolated bus, more than ``MOST_LOOPS`` loops, or a part that does not reach the
        substation.
    """
    rows = _index_buses(name, substation, bus_ids, from_bus, to_bus)
    ends = [(rows[i], rows[j]) for i, j in zip(from_bus, to_bus, strict=True)]
    walk = breadth_first(rows[substation], len(bus_ids), ends)
    fed_by, closing = walk.fed_by, walk.closing
    if len(closing) > MOST_LOOPS:
        k, i, j = closing[MOST_LOOPS]
        raise FeederError(
            f"feeder {name!r} has {len(closing)} loops and at most {MOST_LOOPS} are solved: branch "
            f"{from_bus[k]}-{to_bus[k]} closes a loop over the buses "
            f"{listed([bus_ids[b] for b in _loop(i, j, fed_by)])}; open one of its branches"
        )
    _check_reached(name, substation, bus_ids, ends, fed_by)
    root = rows[substation]
    order = [root] + [i for i in range(len(bus_ids)) if i != root]
    position = {row: i for i, row in enumerate(order)}
    parent = [position[fed_by[row][0]] for row in order[1:]]
    branch = [fed_by[row][1] for row in order[1:]] + [k for k, _, _ in closing]
    loop_ends = [(position[i], position[j]) for _, i, j in closing]
    return np.array(order, dtype=np.intp), parent, np.array(branch, dtype=np.intp), loop_ends


class Walk(NamedTuple):
    """A breadth-first walk over a grid: its tree, and the branches that close loops."""

    fed_by: dict[int, tuple[int, int]]
    """Bus and branch that feed each bus that is reached; -1 and -1 at the root."""
    closing: list[tuple[int, int, int]]
    """Branch, sending bus and receiving bus of each branch that closes a loop, in the order of the walk."""


def breadth_first(root: int, n_bus: int, ends: Sequence[tuple[int, int]]) -> Walk:
    """Walk from bus ``root`` along branches between two buses each.

    The neighbours of a bus are visited in the order of the buses. The tree depends therefore neither on the order of
    the branches nor on their direction. A branch between two buses that are reached already closes a loop; it is sent
    from the one that was reached first.
    """
    neighbours: list[list[tuple[int, int]]] = [[] for _ in range(n_bus)]
    for k, (i, j) in enumerate(ends):
        neighbours[i].append((j, k))
        neighbours[j].append((i, k))
    fed_by: dict[int, tuple[int, int]] = {root: (-1, -1)}
    queue, visited, closing = [root], set(), []
    for i in queue:
        for j, k in sorted(neighbours[i]):
            if k in visited:
                continue
            visited.add(k)
            if j in fed_by:
                closing.append((k, i, j))
                continue
            fed_by[j] = (i, k)
            queue.append(j)
    return Walk(fed_by, closing)


def _index_buses(
    name: str, substation: object, bus_ids: Sequence[Any], from_bus: Sequence[Any], to_bus: Sequence[Any]
) -> dict[Any, int]:
    rows = {bus: i for i, bus in enumerate(bus_ids)}
    if len(rows) < len(bus_ids):
        twice = sorted(str(bus) for bus, times in Counter(bus_ids).items() if times > 1)
        shown = ", ".join(twice[:_MOST_LISTED]) + (", .." if len(twice) > _MOST_LISTED else "")
        raise FeederError(f"feeder {name!r}: duplicate bus {shown}; give each bus one row")
    if substation not in rows:
        raise FeederError(f"feeder {name!r}: substation {substation!r} is not among its buses {listed(bus_ids)}")
    for i, j in zip(from_bus, to_bus, strict=True):
        for bus in (i, j):
            if bus not in rows:
                raise FeederError(f"feeder {name!r}: branch {i}-{j} names the unknown bus {bus!r}; add it to the buses")
        if i == j:
            raise FeederError(f"feeder {name!r}: branch {i}-{j} joins a bus with itself; leave it out")
    return rows


def _loop(i: int, j: int, fed_by: dict[int, tuple[int, int]]) -> list[int]:
    def upstream(b: int) -> list[int]:
        path = []
        while b >= 0:
            path.append(b)
            b = fed_by[b][0]
        return path

    up_i, up_j = upstream(i), upstream(j)
    on_other = set(up_j)
    meet = next(b for b in up_i if b in on_other)
    return up_i[: up_i.index(meet) + 1] + up_j[: up_j.index(meet)][::-1]


def _check_reached(
    name: str,
    substation: object,
    bus_ids: Sequence[Any],
    ends: Sequence[tuple[int, int]],
    fed_by: dict[int, tuple[int, int]],
) -> None:
    unreached = [i for i in range(len(bus_ids)) if i not in fed_by]
    if not unreached:
        return
    joined = {bus for pair in ends for bus in pair}
    isolated = [bus_ids[i] for i in unreached if i not in joined]
    if isolated:
        raise FeederError(
            f"feeder {name!r}: isolated bus {listed(isolated)}: no branch ends there; add one or drop the bus"
        )
    raise FeederError(
        f"feeder {name!r} has more than one root: the buses {listed([bus_ids[i] for i in unreached])} are not "
        f"connected to the substation {substation!r}; add the missing branch"
    )

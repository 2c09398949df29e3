"""What a source feeds through the branches of a grid, the ratios on the way, and the loops."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from dcgrid_env.grid.formats.bus_branch.parallel_branches import Joint
from dcgrid_env.grid.formats.import_report import Report

_LOOPS_NAMED = 5
_NAMES_IN_A_LOOP = 12


@dataclass(frozen=True)
class Supplied:
    """What is fed from one bus."""

    fed: dict[int, float]
    """Voltage referred to the source over the bus's own, each per unit, for the row of every bus that is fed."""
    joints: list[Joint]
    """What feeds each bus but the source's, in the order of the grid's branches."""
    unsupplied: list[Joint]
    """Joints of which no end is fed."""


def supplied_by(root: int, n_bus: int, all_joints: Sequence[Joint], report: Report) -> Supplied:
    """Walk from the source's bus; a joint that closes a loop is refused, with what it closes it with."""
    at_bus: list[list[int]] = [[] for _ in range(n_bus)]
    for k, joint in enumerate(all_joints):
        at_bus[joint.branch.from_bus].append(k)
        at_bus[joint.branch.to_bus].append(k)
    fed, fed_by, queue, seen = {root: 1.0}, {root: (-1, -1)}, [root], set()
    closing: list[tuple[int, int, int]] = []
    for i in queue:
        for k in at_bus[i]:
            if k in seen:
                continue
            seen.add(k)
            branch = all_joints[k].branch
            forward = branch.from_bus == i
            j = branch.to_bus if forward else branch.from_bus
            if j in fed:
                closing.append((k, i, j))
                continue
            fed[j] = fed[i] * branch.tap if forward else fed[i] / branch.tap
            fed_by[j] = (i, k)
            queue.append(j)
    for number, (k, i, j) in enumerate(closing):
        text = "it closes a loop as well: open one of its branches"
        if number < _LOOPS_NAMED:
            others = [all_joints[m].text for m in _path(i, j, fed_by)]
            more = len(others) - _NAMES_IN_A_LOOP
            named = ", ".join(others[:_NAMES_IN_A_LOOP]) + (f" and {more} more" if more > 0 else "")
            text = f"it closes a loop with {named}: open one of them by a switch"
        member = all_joints[k].members[0]
        report.add("refused", member.kind, member.name, text)
    in_tree = {k for _, k in fed_by.values()}
    return Supplied(
        fed,
        [joint for k, joint in enumerate(all_joints) if k in in_tree],
        [joint for joint in all_joints if joint.branch.from_bus not in fed],
    )


def _path(i: int, j: int, fed_by: dict[int, tuple[int, int]]) -> list[int]:
    """Joints on the way between two fed buses."""
    above, up_i = {}, []
    while i >= 0:
        above[i] = len(up_i)
        i, k = fed_by[i]
        up_i.append(k)
    up_j = []
    while j not in above:
        j, k = fed_by[j]
        up_j.append(k)
    return up_i[: above[j]] + up_j[::-1]

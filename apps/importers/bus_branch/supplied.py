"""What a source feeds through the branches of a grid, the ratios on the way, and the loops."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from dcgrid_env.apps.importers.bus_branch.description import Branch
from dcgrid_env.apps.importers.bus_branch.parallel_branches import SAME, Joint
from dcgrid_env.apps.importers.import_report import Report
from dcgrid_env.grid.topology import MOST_LOOPS, breadth_first

_LOOPS_NAMED = 5
_NAMES_IN_A_LOOP = 12


@dataclass(frozen=True)
class Supplied:
    """What is fed from one bus."""

    ratios: dict[int, float]
    """Voltage referred to the source over the bus's own, each per unit, for the row of every bus that is fed."""
    joints: list[Joint]
    """Joints between the buses that are fed, in the order of the grid's branches."""
    loops: dict[int, str]
    """Names of the others in its loop, for the position in ``joints`` of each that closes a loop of the feeder."""
    unsupplied: list[Joint]
    """Joints of which no end is fed."""


def supplied_by(root: int, n_bus: int, all_joints: Sequence[Joint], report: Report) -> Supplied:
    """Walk from the source's bus as ``Feeder`` does, so both take the same joints to close the loops.

    A joint that closes one loop too many, or a loop with a ratio or a phase shift around it, is refused.
    """
    walk = breadth_first(root, n_bus, [(joint.branch.from_bus, joint.branch.to_bus) for joint in all_joints])
    ratios, shift_deg = {root: 1.0}, {root: 0.0}
    for j, (i, k) in walk.fed_by.items():
        if k >= 0:
            ratios[j], shift_deg[j] = _beyond(all_joints[k].branch, i, ratios[i], shift_deg[i])
    loops: dict[int, str] = {}
    for number, (k, i, j) in enumerate(walk.closing):
        member, named = all_joints[k].members[0], ""
        if number < max(MOST_LOOPS, _LOOPS_NAMED):
            others = [all_joints[m].text for m in _path(i, j, walk.fed_by)]
            more = len(others) - _NAMES_IN_A_LOOP
            named = ", ".join(others[:_NAMES_IN_A_LOOP]) + (f" and {more} more" if more > 0 else "")
        ratio, shift = _beyond(all_joints[k].branch, i, ratios[i], shift_deg[i])
        turned = (shift - shift_deg[j] + 180.0) % 360.0 - 180.0
        if len(walk.closing) > MOST_LOOPS:
            text = "it closes a loop as well: open one of its branches"
            if number < _LOOPS_NAMED:
                text = (
                    f"it closes a loop with {named}: at most {MOST_LOOPS} loops are solved and there are "
                    f"{len(walk.closing)}; open one of them by a switch"
                )
            report.add("refused", member.kind, member.name, text)
        elif abs(ratio - ratios[j]) > SAME * ratios[j] or abs(turned) > SAME:
            text = (
                f"it closes a loop with {named}, around which the ratios or phase shifts differ from 1 and 0, so that "
            )
            report.add(
                "refused", member.kind, member.name, text + "a current circulates: give both sides the same taps"
            )
        else:
            loops[k] = named
    kept = [k for k, joint in enumerate(all_joints) if joint.branch.from_bus in ratios]
    return Supplied(
        ratios,
        [all_joints[k] for k in kept],
        {position: loops[k] for position, k in enumerate(kept) if k in loops},
        [joint for joint in all_joints if joint.branch.from_bus not in ratios],
    )


def _beyond(branch: Branch, bus: int, ratio: float, shift_deg: float) -> tuple[float, float]:
    """Ratio and phase shift behind a branch, from those of the bus at one of its ends."""
    if branch.from_bus == bus:
        return ratio * branch.tap, shift_deg + branch.shift_deg
    return ratio / branch.tap, shift_deg - branch.shift_deg


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

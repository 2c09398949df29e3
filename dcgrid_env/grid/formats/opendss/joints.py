"""Connections between two buses before their direction is known, and the tree that they form."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True)
class Joint:
    """One row of lines, switches or transformers, with its ends in OpenDSS's order."""

    kind: str
    """The table of ``Network``: phase_line, switch or transformer."""
    name: str
    ends: tuple[str, str]
    phases: str
    closed: bool
    values: dict[str, Any]
    """The other columns of the row."""


def phases_of(nodes: Iterable[int]) -> str:
    """Phases of nodes as a text in the order of the alphabet, ground left out."""
    return "".join("abc"[node - 1] for node in sorted(node for node in nodes if node))


@dataclass(frozen=True)
class Supply:
    """The buses that are fed from the source, and in which order."""

    depth: dict[str, int]
    """Branches between the source bus and each bus that has supply."""
    phases: dict[str, str]
    """Phases that each bus is fed with."""
    loops: tuple[tuple[Joint, ...], ...]
    """The joints of each loop, first the one that closes it."""

    def fed(self, joint: Joint) -> bool:
        """Whether both ends have supply."""
        return all(end in self.depth for end in joint.ends)


def supply_of(source: str, joints: Sequence[Joint]) -> Supply:
    """Follow the closed joints from the source bus; where a loop could be named by several, by a switch."""
    joints_of_bus: dict[str, list[Joint]] = {}
    for joint in sorted(joints, key=lambda joint: joint.kind == "switch"):
        for end in set(joint.ends) if joint.closed else ():
            joints_of_bus.setdefault(end, []).append(joint)
    depth, phases, loops = {source: 0}, {source: "abc"}, []
    fed_by: dict[str, tuple[str, Joint]] = {}
    used: set[int] = set()
    queue = [source]
    for bus in queue:
        for joint in joints_of_bus.get(bus, ()):
            if id(joint) in used:
                continue
            used.add(id(joint))
            other = joint.ends[1] if joint.ends[0] == bus else joint.ends[0]
            if other in depth:
                loops.append((joint, *_between(bus, other, depth, fed_by)))
                continue
            depth[other], phases[other], fed_by[other] = depth[bus] + 1, joint.phases, (bus, joint)
            queue.append(other)
    return Supply(depth, phases, tuple(loops))


def _between(first: str, second: str, depth: dict[str, int], fed_by: dict[str, tuple[str, Joint]]) -> Iterable[Joint]:
    """The joints on the way from one bus that has supply to another."""
    while first != second:
        if depth[first] < depth[second]:
            first, second = second, first
        first, joint = fed_by[first]
        yield joint

"""Connections between buses before their direction is known, and what they supply."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from typing import Any

from dcgrid_env.grid.three_phase_tables import LETTERS
from dcgrid_env.grid.topology import FeederError

Node = tuple[str, str]
"""Bus and letter of a conductor."""


@dataclass(frozen=True)
class Joint:
    """One row of lines, switches, transformers or admittances, with its ends in OpenDSS's order."""

    kind: str
    """The table of ``Network``: phase_line, switch, transformer or admittance."""
    name: str
    ends: tuple[str, ...]
    phases: str
    """Phases at both ends; empty for an admittance, which has nodes."""
    closed: bool
    values: dict[str, Any] = field(default_factory=dict)
    """The other columns of the row."""
    nodes: tuple[Node, ...] = ()
    """Nodes of an admittance, in the order of its matrix."""
    parts: tuple[tuple[Node, ...], ...] = ()
    """Groups of the nodes that it connects with each other."""
    members: tuple[str, ...] = ()
    """The elements that it is, as class.name."""

    @property
    def node_groups(self) -> Sequence[Sequence[Node]]:
        """All its nodes, those that it connects with each other together."""
        return self.parts or [[(bus, phase) for bus in self.ends for phase in self.phases]]


@dataclass
class Letters:
    """Letters of OpenDSS's nodes: the k-th of the alphabet for node k, and unused ones for nodes beyond 26."""

    numbers: Iterable[int]
    """All numbers of nodes in the circuit."""

    def __post_init__(self) -> None:
        numbers = sorted(set(self.numbers) - {0})
        self._letters = {number: LETTERS[number - 1] for number in numbers if number <= len(LETTERS)}
        free = [letter for letter in LETTERS[3:] if letter not in self._letters.values()]
        self.beyond = [number for number in numbers if number > len(LETTERS)]
        if len(self.beyond) > len(free):
            raise FeederError(f"the circuit numbers its nodes {numbers}; at most {len(LETTERS)} can be represented")
        self._letters |= dict(zip(self.beyond, free, strict=False))

    def __getitem__(self, number: int) -> str:
        return self._letters[number]

    def text(self, nodes: Iterable[int]) -> str:
        """Letters of nodes as a text in the order of the alphabet, ground left out."""
        return "".join(sorted(self._letters[node] for node in nodes if node))


@dataclass(frozen=True)
class Supply:
    """The buses that are fed from the source, and in which order."""

    depth: dict[str, int]
    """Branches between the source bus and each bus that has supply."""
    phases: dict[str, str]
    """Letters of the conductors that each bus is fed with."""

    def has(self, nodes: Iterable[Node]) -> bool:
        """Whether all these nodes have supply."""
        return all(letter in self.phases.get(bus, "") for bus, letter in nodes)

    def is_fed(self, joint: Joint) -> bool:
        """Whether a joint has supply at all nodes of one of its groups."""
        return any(map(self.has, joint.node_groups))


def supply_of(source: str, joints: Sequence[Joint], legs: Sequence[Sequence[Node]] = ()) -> Supply:
    """Follow the closed joints from the source bus.

    ``legs`` are the nodes of each leg that draws. A leg with supply at one node supplies the other, if this is no phase
    or no joint reaches it. The neutral of a star is such a node.
    """
    node_groups: dict[Node, list[Sequence[Node]]] = {}
    reached: set[Node] = set()
    for joint in joints:
        for group in joint.node_groups:
            reached.update(group)
            for node in group if joint.closed else ():
                node_groups.setdefault(node, []).append(group)
    depth: dict[Node, int] = {(source, phase): 0 for phase in "abc"}
    reached.update(depth)
    for nodes in legs:
        carried = [node for node in nodes if node not in reached or node[1] > "c"]
        for node in nodes if carried else ():
            node_groups.setdefault(node, []).append(carried)
    used: set[int] = set()
    queue = list(depth)
    for node in queue:
        for group in node_groups.get(node, ()):
            if id(group) in used:
                continue
            used.add(id(group))
            for other in group:
                if other not in depth:
                    depth[other] = depth[node] + (other[0] != node[0])
                    queue.append(other)
    of_bus: dict[str, int] = {}
    letters: dict[str, set[str]] = {}
    for (bus, letter), hops in depth.items():
        of_bus[bus] = min(hops, of_bus.get(bus, hops))
        letters.setdefault(bus, set()).add(letter)
    return Supply(of_bus, {bus: "".join(sorted(phases)) for bus, phases in letters.items()})

"""Parallel branches between two buses, combined into one."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

from dcgrid_env.apps.importers.bus_branch.description import Branch
from dcgrid_env.apps.importers.import_report import Report

SAME = 1e-9
"""Relative difference of ratios, and of phase shifts in degrees, below which two ways to a bus are alike."""


@dataclass(frozen=True)
class Joint:
    """The connection between two buses: one branch, or parallel branches combined into one."""

    branch: Branch
    members: tuple[Branch, ...]

    @property
    def text(self) -> str:
        """Kinds and names of its elements."""
        return " and ".join(f"{one.kind} {one.name}" for one in self.members)


def joints(branches: Sequence[Branch], report: Report) -> list[Joint]:
    """Return one joint for every connected pair of buses; parallel transformers that differ are refused."""
    beside: dict[tuple[int, int], list[Branch]] = {}
    for branch in branches:
        pair = (min(branch.from_bus, branch.to_bus), max(branch.from_bus, branch.to_bus))
        beside.setdefault(pair, []).append(branch)
    return [Joint(_as_one(members, report), tuple(members)) for members in beside.values()]


def _as_one(members: list[Branch], report: Report) -> Branch:
    first = members[0]
    if len(members) == 1:
        return first
    alike = [one if one.from_bus == first.from_bus else one.reversed() for one in members]
    for member, one in zip(members[1:], alike[1:], strict=True):
        turned = (one.shift_deg - first.shift_deg + 180.0) % 360.0 - 180.0
        if abs(one.tap - first.tap) > SAME * first.tap or abs(turned) > SAME:
            text = f"it stands beside {first.kind} {first.name} with another ratio or phase shift, so that a current "
            report.add("refused", member.kind, member.name, text + "circulates: give both the same tap position")
            return first
        report.add(
            "taken", member.kind, member.name, f"parallel to {first.kind} {first.name}: one branch, of their impedance"
        )
    shorted = [one for one in alike if one.z_pu == 0]
    if shorted:
        return replace(shorted[0], rating_pu=math.nan if len(shorted) > 1 else shorted[0].rating_pu)
    total = sum(1.0 / one.z_pu for one in alike)
    if total == 0:
        report.add("refused", first.kind, first.name, "it resonates with what is parallel to it: no impedance is left")
        return first
    # Each carries its share of the current, y / total: what reaches its rating first limits them all.
    limits = [one.rating_pu * abs(total * one.z_pu) for one in alike]
    known = [limit for limit in limits if not math.isnan(limit)]
    return replace(first, z_pu=1.0 / total, rating_pu=min(known, default=math.nan))

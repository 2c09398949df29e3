"""The record of an import: the figures that the terminal, import_report.json and import_report.html show."""

from __future__ import annotations

import math
import shlex
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any

from dcgrid_env.core.versions import command_words, meta, versions

if TYPE_CHECKING:
    from rich.table import Table

    from dcgrid_env import Feeder, ThreePhaseFeeder
    from dcgrid_env.apps.importers.import_report import Finding
    from dcgrid_env.apps.importers.opendss import LossEffect

CLOSE_PU = 1e-6
"""Largest voltage difference between two power flows of the same circuit, p.u."""
_FORMAT = "dcgrid import report 1"
_SHOWN = 5
_PROGRAMS = ("OpenDSSDirect.py", "pandapower", "power-grid-model")


@dataclass(frozen=True)
class Difference:
    """Voltage difference between dcgrid and the source's solver at a node or bus."""

    node: str
    difference_pu: float
    difference_v: float


@dataclass(frozen=True)
class Comparison:
    """Voltages of the tables by dcgrid compared with those of a circuit by the source's solver.

    Attributes
    ----------
    circuit
        What the source's solver solved.
    solver
        Name of that solver.
    largest
        The five largest differences, the largest first; empty if the voltages are not compared.
    without_solution
        Solvers that found no solution.
    """

    circuit: str
    solver: str
    largest: tuple[Difference, ...]
    without_solution: tuple[str, ...] = ()

    @property
    def is_close(self) -> bool:
        """Whether no difference is larger than ``CLOSE_PU``."""
        return bool(self.largest) and self.largest[0].difference_pu <= CLOSE_PU

    def __str__(self) -> str:
        if not self.largest:
            return f"voltages are not compared: no power flow solution from {' and '.join(self.without_solution)}"
        where = ", ".join(f"{one.node} ({one.difference_pu:.1e})" for one in self.largest)
        most = f"{self.largest[0].difference_pu:.1e} p.u."
        return f"largest voltage difference from {self.solver}, {self.circuit}: {most}; largest at {where}"


@dataclass(frozen=True)
class RatedKind:
    """How many branches of a kind have a known rating, and the names of those without."""

    kind: str
    known: int
    number: int
    not_known: tuple[str, ...]


@dataclass(frozen=True)
class ImportRecord:
    """All figures of the report on an import.

    Attributes
    ----------
    feeder, source
        Name of the feeder and what it was read from.
    files
        Name and SHA-256 of each file that was read.
    command, versions
        Command to reproduce the import, and the versions of the packages.
    counts, load_kw, base_kv
        Numbers of buses and other parts, load, and base voltage at the source, line to line.
    findings
        What became of each element.
    effects
        What the lost elements change in the source's power flow.
    comparisons
        Voltages compared with the whole circuit and, if elements are lost, with the circuit without them.
    ratings
        Known ratings by kind of branch.
    notes
        Further lines that the user should read.
    """

    feeder: str
    source: str
    files: tuple[tuple[str, str], ...]
    command: str
    versions: dict[str, str | None]
    counts: dict[str, int]
    load_kw: float
    base_kv: float
    findings: tuple[Finding, ...]
    effects: tuple[LossEffect, ...]
    comparisons: tuple[Comparison, ...]
    ratings: tuple[RatedKind, ...]
    notes: tuple[str, ...] = ()

    @property
    def has_losses(self) -> bool:
        """Whether something that matters was left out."""
        return any(row.fate == "lost" for row in self.findings)

    @property
    def size(self) -> str:
        """Size of the feeder in words."""
        parts = ", ".join(f"{number} {kind}" for kind, number in self.counts.items())
        return f"{parts}, {self.load_kw:.1f} kW at {self.base_kv:g} kV"

    @property
    def verdicts(self) -> tuple[str, ...]:
        """Sentences on differences that are larger than those of two power flows of one circuit."""
        whole, last = self.comparisons[0], self.comparisons[-1]
        if not whole.largest or whole.is_close:
            return ()
        why = "although no element was omitted; the tables may be wrong, please report this file"
        if self.has_losses:
            why = "because of the omitted elements"
            if last is not whole and last.largest and not last.is_close:
                why = "also without the omitted elements; the tables may be wrong, please report this file"
        return (f"voltages differ by more than {CLOSE_PU:g} p.u. {why}",)

    @property
    def unverified(self) -> str:
        """Why the power flow of the source's program does not verify the tables; empty if it does.

        If elements are omitted, the comparison with the circuit without them counts.
        """
        last = self.comparisons[-1]
        if last.is_close or (last.largest and self.has_losses and len(self.comparisons) == 1):
            return ""
        return " and ".join(self.verdicts) if last.largest else str(last)

    @property
    def lines(self) -> tuple[str, ...]:
        """The report in lines of text, without the findings."""
        effects = map(effect_text, self.effects)
        return (*self.notes, *effects, *map(str, self.comparisons), *self.verdicts, self._coverage)

    @property
    def _coverage(self) -> str:
        from dcgrid_env.powerflow import RatingCoverage

        without = tuple(f"{row.kind} {name}" for row in self.ratings for name in row.not_known)
        return str(
            RatingCoverage(sum(row.known for row in self.ratings), sum(row.number for row in self.ratings), without)
        )

    def as_json(self) -> dict[str, Any]:
        """The record as plain values; a figure that is not known is None."""
        files = [{"name": name, "sha256": digest} for name, digest in self.files]
        return _to_plain({"format": _FORMAT} | asdict(self) | {"files": files, "unverified": self.unverified})


def effect_text(effect: LossEffect) -> str:
    """What lost elements change, in one line."""
    subject = f"omitted {', '.join(effect.kinds)} ({effect.number})"
    if not effect.node:
        return f"{subject}: the change is not known, OpenDSS finds no solution without"
    v, pu, kw, kvar = effect_figures(effect)
    if {v, kw, kvar} == {"0"}:
        return f"{subject}: no change of voltages and source power with controls off"
    return f"{subject}: largest voltage change {v} V ({pu} p.u.) at {effect.node}; source power {kw} kW, {kvar} kvar"


def effect_figures(effect: LossEffect) -> tuple[str, str, str, str]:
    """The changes in V, p.u., kW and kvar as texts; what is below the solver's tolerance is 0."""
    values = (effect.change_v, effect.change_pu, effect.change_kw, effect.change_kvar)
    least = (1e-5, 1e-9, 1e-5, 1e-5)
    known = zip(values, least, strict=True)
    v, pu, kw, kvar = (
        "not known" if math.isnan(one) else "0" if abs(one) < low else f"{one:+.3g}" for one, low in known
    )
    return v, pu, kw, kvar


def compared(
    circuit: str,
    solver: str,
    ours: Mapping[str, complex] | None,
    theirs: Mapping[str, complex],
    base_v: Mapping[str, float],
) -> Comparison:
    """Compare the voltages in p.u. of nodes that both have; None or no voltages are a power flow without solution."""
    if ours is None or not theirs:
        without = [name for name, is_solved in ((solver, bool(theirs)), ("dcgrid", ours is not None)) if not is_solved]
        return Comparison(circuit, solver, (), tuple(without))
    apart = {node: float(abs(v - theirs[node])) for node, v in ours.items() if node in theirs}
    worst = sorted(apart, key=lambda node: -apart[node])[:_SHOWN]
    return Comparison(
        circuit, solver, tuple(Difference(node, apart[node], apart[node] * base_v[node]) for node in worst)
    )


def ratings_by_kind(feeder: Feeder | ThreePhaseFeeder) -> tuple[RatedKind, ...]:
    """Count the branches of each kind whose rating is known."""
    from dcgrid_env import rating_coverage

    unknown = set(rating_coverage(feeder).not_checked)
    names: dict[str, list[str]] = {}
    for full in feeder.branch_names:
        names.setdefault(full.partition(" ")[0], []).append(full)
    kinds = []
    for kind, full_names in names.items():
        without = tuple(full.partition(" ")[2] for full in full_names if full in unknown)
        kinds.append(RatedKind(kind, len(full_names) - len(without), len(full_names), without))
    return tuple(kinds)


def reproduction() -> dict[str, Any]:
    """The command that runs and the versions of the packages that it uses."""
    installed = {name: text for name, text in versions(_PROGRAMS).items() if text}
    return {"command": shlex.join(command_words()), "versions": meta()["versions"] | installed}


def findings_table(findings: Iterable[Finding]) -> Table:
    """Return a terminal table with the outcome for each element."""
    from rich.table import Table

    table = Table("element", "number", "names", "outcome", box=None, header_style="bold", pad_edge=False)
    for row in findings:
        fate = "" if row.fate == "taken" else f"{row.fate}: "
        table.add_row(row.kind, str(len(row.names)), row.shown, fate + row.text)
    return table


def _to_plain(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {key: _to_plain(one) for key, one in value.items()}
    if isinstance(value, list | tuple):
        return [_to_plain(one) for one in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value

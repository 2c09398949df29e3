"""The commands ``dcgrid import opendss`` and ``gridlabd``."""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import tyro

from dcgrid_env.cli.command import Command
from dcgrid_env.cli.settings import check_folder
from dcgrid_env.cli.terminal import plain_console, say

if TYPE_CHECKING:
    from rich.table import Table

    from dcgrid_env import ThreePhaseFeeder
    from dcgrid_env.grid.formats.opendss import Finding, Imported

CLOSE_PU = 1e-6
"""Largest voltage difference between two power flows of the same circuit, p.u."""
_SHOWN = 5


@dataclass(frozen=True, kw_only=True)
class _ThreePhaseImport(Command):
    """Base class of the imports of three-phase grids."""

    out: Path
    """Folder for the tables. It must be new or empty."""
    allow: str = ""
    """Types of elements to omit even if this changes the grid, separated by commas, for example capcontrol,fuse."""
    root: Path | None = None
    """Folder below which the file may read others, for example that of a whole repository. Default: the folder of
    the file."""

    @abstractmethod
    def read(self, allow: list[str]) -> Imported:
        """Read the grid."""

    def run(self) -> None:
        """Read, compile, solve, report the outcome for each element, and write; write nothing on an error."""
        from dcgrid_env import ThreePhaseFeeder, rating_coverage
        from dcgrid_env.core.files import whole_folder

        if self.out.exists() and (not self.out.is_dir() or any(self.out.iterdir())):
            raise ValueError(f"out: must be a new or empty folder, got {self.out}; choose another --out")
        check_folder(self.out)
        imported = self.read([kind.strip() for kind in self.allow.split(",") if kind.strip()])
        feeder = ThreePhaseFeeder.from_network(imported.network)
        said = compared(imported, feeder)
        with whole_folder(self.out) as folder:
            feeder.to_csv(folder)
        console = plain_console()
        console.print(findings_table(imported.findings))
        for line in (*said, str(rating_coverage(feeder))):
            say(console, line)
        say(console, f"wrote {self.out}: {feeder.n_bus} buses, {feeder.n_node} nodes, {feeder.n_regulator} regulators")


@dataclass(frozen=True)
class ImportOpenDss(_ThreePhaseImport):
    """Read a three-phase feeder from an OpenDSS master file.

    Writes the feeder as a folder of tables and compares the voltages.

    The command checks the script before it runs. It omits commands that show or write results. It reports an error
    for other commands that do not define the model, files outside the root folder, and elements that it cannot
    represent (docs/opendss.md).
    """

    master: tyro.conf.Positional[Path]
    """Master file. It may redirect to other files in the root folder or below."""
    trust: bool = False
    """Run the script without the check, with all its effects on this machine. Use it only for trusted files."""

    def read(self, allow: list[str]) -> Imported:
        """Read the circuit."""
        from dcgrid_env.grid.formats.opendss import read_opendss

        return read_opendss(self.master, allow=allow, trust=self.trust, root=self.root)


@dataclass(frozen=True)
class ImportGridlabd(_ThreePhaseImport):
    """Read a three-phase feeder from a GridLAB-D model.

    Writes the feeder as a folder of tables and compares the voltages with OpenDSS.

    Only the network is read. The command executes nothing, omits recorders and settings of the simulation, and
    reports an error for directives that start programs, files outside the root folder, and elements that it cannot
    represent (docs/gridlabd.md).
    """

    file: tyro.conf.Positional[Path]
    """Model file (.glm). It may include other files in the root folder or below."""

    def read(self, allow: list[str]) -> Imported:
        """Read the model."""
        from dcgrid_env.grid.formats.gridlabd import read_gridlabd

        return read_gridlabd(self.file, allow=allow, root=self.root)


def findings_table(findings: tuple[Finding, ...]) -> Table:
    """Return a terminal table with the outcome for each element."""
    from rich.table import Table

    table = Table("element", "number", "names", "outcome", box=None, header_style="bold", pad_edge=False)
    for row in findings:
        fate = "" if row.fate == "taken" else f"{row.fate}: "
        table.add_row(row.kind, str(len(row.names)), row.shown, fate + row.text)
    return table


def compared(imported: Imported, feeder: ThreePhaseFeeder) -> list[str]:
    """Return lines on the largest differences of complex voltages between dcgrid and OpenDSS."""
    import numpy as np

    from dcgrid_env.powerflow import solve_unbalanced

    solution = solve_unbalanced(feeder, feeder.p_load_kw, feeder.q_load_kvar)
    found = {"OpenDSS": bool(imported.v_pu), "dcgrid": bool(solution.converged)}
    failed = [name for name, converged in found.items() if not converged]
    if failed:
        return [f"voltages are not compared: no power flow solution from {' and '.join(failed)}"]
    ours = np.asarray(solution.v_re_pu) + 1j * np.asarray(solution.v_im_pu)
    apart = {name: abs(v - imported.v_pu[name]) for name, v in zip(feeder.node_ids, ours, strict=True)
             if name in imported.v_pu}  # fmt: skip
    worst = sorted(apart, key=lambda name: -apart[name])[:_SHOWN]
    where = ", ".join(f"{name} ({apart[name]:.1e})" for name in worst)
    lines = [f"largest voltage difference from OpenDSS, controls off: {apart[worst[0]]:.1e} p.u.; largest at {where}"]
    if apart[worst[0]] > CLOSE_PU:
        lost = [row for row in imported.findings if row.fate == "lost"]
        why = "because of the omitted elements" if lost else "although no element was omitted; the tables may be wrong"
        lines.append(f"voltages differ by more than {CLOSE_PU:g} p.u. {why}")
    return lines

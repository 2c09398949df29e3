"""The command ``dcgrid import opendss``."""

from __future__ import annotations

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
"""Voltage difference beyond which the two power flows are not of the same circuit."""
_SHOWN = 5


@dataclass(frozen=True)
class ImportOpenDss(Command):
    """Read a three-phase feeder from an OpenDSS master file.

    Writes the feeder as a folder of tables and compares the voltages.

    The script is looked at first: commands beyond a model's definition, and files that are not beneath its folder, are
    refused (docs/opendss.md). So are elements that cannot be represented, by name.
    """

    master: tyro.conf.Positional[Path]
    """The master file; it may redirect to others beneath its folder."""
    out: Path
    """Folder for the tables; it must be new or empty."""
    allow: str = ""
    """Kinds of elements, separated by commas, that may be left out although something is lost: capcontrol,fuse."""
    trust: bool = False
    """Run the script as it is, whatever it does to this machine."""

    def run(self) -> None:
        """Read, compile, solve, report what became of each element, and write; nothing is written on an error."""
        from dcgrid_env import ThreePhaseFeeder, rating_coverage
        from dcgrid_env.core.files import whole_folder
        from dcgrid_env.grid.formats.opendss import read_opendss

        if self.out.exists() and (not self.out.is_dir() or any(self.out.iterdir())):
            raise ValueError(f"out: {self.out} is there and not an empty folder; choose another --out")
        check_folder(self.out)
        allow = [kind.strip() for kind in self.allow.split(",") if kind.strip()]
        imported = read_opendss(self.master, allow=allow, trust=self.trust)
        feeder = ThreePhaseFeeder.from_network(imported.network)
        said = compared(imported, feeder)
        with whole_folder(self.out) as folder:
            feeder.to_csv(folder)
        console = plain_console()
        console.print(findings_table(imported.findings))
        for line in (*said, str(rating_coverage(feeder))):
            say(console, line)
        say(console, f"wrote {self.out}: {feeder.n_bus} buses, {feeder.n_node} nodes, {feeder.n_regulator} regulators")


def findings_table(findings: tuple[Finding, ...]) -> Table:
    """What became of each element, as a table for the terminal."""
    from rich.table import Table

    table = Table("element", "number", "names", "what became of them", box=None, header_style="bold", pad_edge=False)
    for row in findings:
        fate = "" if row.fate == "taken" else f"{row.fate}: "
        table.add_row(row.kind, str(len(row.names)), row.shown, fate + row.text)
    return table


def compared(imported: Imported, feeder: ThreePhaseFeeder) -> list[str]:
    """Lines that say how far our voltages are from OpenDSS's, as complex figures, and at which nodes most."""
    import numpy as np

    from dcgrid_env.powerflow import solve_unbalanced

    solution = solve_unbalanced(feeder, feeder.p_load_kw, feeder.q_load_kvar)
    found = {"OpenDSS": bool(imported.v_pu), "our power flow": bool(solution.converged)}
    failed = [name for name, converged in found.items() if not converged]
    if failed:
        return [f"{' and '.join(failed)} found no solution, so that voltages are not compared"]
    ours = np.asarray(solution.v_re_pu) + 1j * np.asarray(solution.v_im_pu)
    apart = {name: abs(v - imported.v_pu[name]) for name, v in zip(feeder.node_ids, ours, strict=True)
             if name in imported.v_pu}  # fmt: skip
    worst = sorted(apart, key=lambda name: -apart[name])[:_SHOWN]
    where = ", ".join(f"{name} ({apart[name]:.1e})" for name in worst)
    lines = [f"largest voltage difference to OpenDSS, controls off: {apart[worst[0]]:.1e} p.u.; most at {where}"]
    if apart[worst[0]] > CLOSE_PU:
        lost = [row for row in imported.findings if row.fate == "lost"]
        why = "what is lost moves them" if lost else "nothing is said to be lost, so that the tables may be wrong"
        lines.append(f"the voltages differ by more than {CLOSE_PU:g} p.u.: {why}")
    return lines

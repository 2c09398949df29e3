"""Import every OpenDSS circuit in a folder and print a table: ``python -m docs.studies circuits FOLDER``.

A circuit is a script that has a line ``New Circuit``, or the script ``Master*`` in its folder that redirects to it.
"""

from __future__ import annotations

import re
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import tyro

from dcgrid_env import FeederError, ThreePhaseFeeder
from dcgrid_env.apps.importers.opendss import Imported, read_opendss
from dcgrid_env.core.commands.command import Command
from dcgrid_env.powerflow import solve_unbalanced

_CIRCUIT = re.compile(r"^\s*new\s+(object\s*=\s*)?circuit\.", re.IGNORECASE | re.MULTILINE)
HEAD = """| circuit | nodes | solved by | of it admittances | largest difference, p.u. | at | s |
|---|---|---|---|---|---|---|"""


@dataclass(frozen=True)
class Circuits(Command):
    """Import every OpenDSS circuit in a folder.

    It prints a table. A row has the largest voltage difference from OpenDSS, or the reason for a refusal.
    """

    folder: tyro.conf.Positional[Path]
    """Folder of circuits. Scripts may read all files below it."""
    allow: str = ""
    """Types of elements to omit even if this changes the grid, separated by commas, for example fuse."""

    def run(self) -> None:
        """Print the table, a row for each circuit as it is done."""
        allow = [kind.strip() for kind in self.allow.split(",") if kind.strip()]
        print(HEAD)
        for master in masters(self.folder):
            print(row(master, self.folder, allow), flush=True)


def masters(folder: Path) -> Iterator[Path]:
    """Scripts below a folder that define a circuit, by name."""
    for path in sorted(folder.rglob("*")):
        if path.suffix.lower() == ".dss" and _CIRCUIT.search(path.read_text(encoding="latin-1")):
            above = [other for other in path.parent.glob("[Mm]aster*") if path.name.lower() in _text(other)]
            yield above[0] if above and not path.name.lower().startswith("master") else path


def _text(path: Path) -> str:
    return path.read_text(encoding="latin-1").lower()


def row(master: Path, root: Path, allow: list[str]) -> str:
    """A row of the table."""
    name, start = master.relative_to(root).as_posix(), time.perf_counter()
    try:
        imported = read_opendss(master, allow=allow, root=root)
        feeder = ThreePhaseFeeder.from_network(imported.network)
        where, apart = farthest(imported, feeder)
    except FeederError as error:
        text = str(error).replace(str(master), "").replace("|", "/")
        return f"| {name} | refused: {text[:300]} |"
    took_s, by = time.perf_counter() - start, "sweep" if feeder.is_radial else "nodal equations"
    n = len(feeder.network.admittance)
    return f"| {name} | {feeder.n_node} | {by} | {n} | {apart:.1e} | {where} | {took_s:.0f} |"


def farthest(imported: Imported, feeder: ThreePhaseFeeder) -> tuple[str, float]:
    """The node whose complex voltage differs most from OpenDSS's, and by how much, p.u."""
    solution = solve_unbalanced(feeder, feeder.p_load_kw, feeder.q_load_kvar)
    if not solution.converged or not imported.v_pu:
        return "no solution", float("nan")
    ours = dict(zip(feeder.node_ids, solution.v_re_pu + 1j * solution.v_im_pu, strict=True))
    apart = {node: float(np.abs(ours[node] - v)) for node, v in imported.v_pu.items()}
    where = max(apart, key=lambda node: apart[node])
    return where, apart[where]

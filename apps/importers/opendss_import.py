"""The commands ``dcgrid import opendss`` and ``gridlabd``."""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import tyro

from dcgrid_env.apps.importers.import_output import ImportOutput
from dcgrid_env.apps.importers.import_record import ImportRecord, compared, ratings_by_kind, reproduction
from dcgrid_env.core.commands.command import Command
from dcgrid_env.grid.three_phase_tables import LETTERS

if TYPE_CHECKING:
    from dcgrid_env import ThreePhaseFeeder
    from dcgrid_env.apps.importers.opendss import Imported


@dataclass(frozen=True, kw_only=True)
class _ThreePhaseImport(Command):
    """Base class of the imports of three-phase grids."""

    out: Path
    """Folder for the tables. It must be new or empty."""
    allow: str = ""
    """Types of elements to omit even if this changes the grid, separated by commas, for example isource,isolated.
    unverified accepts a feeder whose voltages are not those of OpenDSS."""
    root: Path | None = None
    """Folder below which the file may read others, for example that of a whole repository. Default: the folder of
    the file."""

    @abstractmethod
    def read(self, allow: list[str]) -> Imported:
        """Read the grid."""

    def run(self) -> None:
        """Read, compile, solve, report the outcome for each element, and write; write nothing on an error."""
        from dcgrid_env import ThreePhaseFeeder
        from dcgrid_env.apps.importers.opendss import write_imported_profiles

        output = ImportOutput(self.out, self.allow)
        output.check()
        imported = self.read(output.kinds)
        feeder = ThreePhaseFeeder.from_network(imported.network)

        def tables(folder: Path) -> None:
            feeder.to_csv(folder)
            write_imported_profiles(imported.profiles, folder)

        output.write(recorded(imported, feeder), tables)


@dataclass(frozen=True)
class ImportOpenDss(_ThreePhaseImport):
    """Read a three-phase feeder from an OpenDSS master file.

    Writes the feeder as a folder of tables with a report, and compares the voltages.

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
        from dcgrid_env.apps.importers.opendss import read_opendss

        return read_opendss(self.master, allow=allow, trust=self.trust, root=self.root)


@dataclass(frozen=True)
class ImportGridlabd(_ThreePhaseImport):
    """Read a three-phase feeder from a GridLAB-D model.

    Writes the feeder as a folder of tables with a report, and compares the voltages with OpenDSS.

    Only the network is read. The command executes nothing, omits recorders and settings of the simulation, and
    reports an error for directives that start programs, files outside the root folder, and elements that it cannot
    represent (docs/gridlabd.md).
    """

    file: tyro.conf.Positional[Path]
    """Model file (.glm). It may include other files in the root folder or below."""

    def read(self, allow: list[str]) -> Imported:
        """Read the model."""
        from dcgrid_env.apps.importers.gridlabd import read_gridlabd

        return read_gridlabd(self.file, allow=allow, root=self.root)


def recorded(imported: Imported, feeder: ThreePhaseFeeder) -> ImportRecord:
    """Return the record of an import, with the voltages by dcgrid compared with those by OpenDSS."""
    from dcgrid_env.powerflow import solve_unbalanced

    solution = solve_unbalanced(feeder, feeder.p_load_kw, feeder.q_load_kvar)
    ours = None
    if solution.converged:
        v_pu = np.asarray(solution.v_re_pu) + 1j * np.asarray(solution.v_im_pu)
        ours = dict(zip(feeder.node_ids, v_pu.tolist(), strict=True))
    node = feeder.network.node
    names = (f"{bus}.{LETTERS[phase - 1]}" for bus, phase in zip(node.bus, node.phase, strict=True))
    base_v = {name: 1000.0 * kv for name, kv in zip(names, node.base_kv_ln, strict=True)}
    solved = [("controls off", imported.v_pu)]
    if any(row.fate == "lost" for row in imported.findings):
        solved.append(("controls off, without the omitted elements", imported.v_pu_without))
    counts = {"buses": feeder.n_bus, "nodes": feeder.n_node, "regulators": feeder.n_regulator}
    run_facts = reproduction()
    return ImportRecord(
        feeder=imported.network.name,
        source=imported.network.source_of_facts,
        files=imported.files,
        command=run_facts["command"],
        versions=run_facts["versions"] | {"OpenDSS": imported.engine},
        counts=counts,
        load_kw=float(feeder.p_load_kw.sum()),
        base_kv=float(feeder.network.source.base_kv[0]),
        findings=imported.findings,
        effects=imported.effects,
        comparisons=tuple(compared(circuit, "OpenDSS", ours, theirs, base_v) for circuit, theirs in solved),
        ratings=ratings_by_kind(feeder),
    )

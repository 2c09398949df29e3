"""The commands ``dcgrid import pandapower``, ``matpower`` and ``power-grid-model``."""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import tyro

from dcgrid_env.apps.importers.import_output import ImportOutput
from dcgrid_env.apps.importers.import_record import Comparison, ImportRecord, compared, ratings_by_kind, reproduction
from dcgrid_env.core.commands.command import Command
from dcgrid_env.core.user_files import parse_json

if TYPE_CHECKING:
    from dcgrid_env import Feeder
    from dcgrid_env.apps.importers.bus_branch import ImportedFeeder

PROFILES = "load_profiles.csv"
"""File with the load of each bus over time, if the grid has profiles."""
MERGED = "merged_buses.csv"
"""File that maps the source's buses that closed switches merged to the feeder's buses."""


@dataclass(frozen=True, kw_only=True)
class _Import(Command):
    """Base class of the imports of balanced grids."""

    out: Path
    """Folder for the tables. It must be new or empty."""
    source: str | None = None
    """Source bus of the island to import, if the grid has several."""
    allow: str = ""
    """Types of elements to omit even if this changes the grid, separated by commas, for example controller,load.
    unverified accepts a feeder whose voltages are not those of the source's program."""
    bus_names: bool = False
    """Use the bus names of the file as bus ids instead of the numbers."""

    @abstractmethod
    def read(self, allow: list[str]) -> ImportedFeeder:
        """Read the grid."""

    def run(self) -> None:
        """Read, reduce, solve, report the outcome for each element, and write; write nothing on an error."""
        from dcgrid_env import Feeder
        from dcgrid_env.traces import write_profiles

        output = ImportOutput(self.out, self.allow)
        output.check()
        imported = self.read(output.kinds)
        feeder = Feeder.from_network(imported.network)

        def tables(folder: Path) -> None:
            feeder.to_csv(folder)
            _write_merged(imported, folder)
            if imported.profiles is not None:
                about = "load of each bus in kW and kvar: columns = bus, unit = kw, uncovered = nominal"
                write_profiles(imported.profiles, folder / PROFILES, [about])

        output.write(self._record(imported, feeder), tables)

    @property
    @abstractmethod
    def origin(self) -> str:
        """The file, or the name of the grid."""

    def _record(self, imported: ImportedFeeder, feeder: Feeder) -> ImportRecord:
        from dcgrid_env.core.files import sha256_of

        path, run_facts = Path(self.origin), reproduction()
        return ImportRecord(
            feeder=imported.network.name,
            source=imported.network.source_of_facts or self.origin,
            files=((path.name, sha256_of(path)),) if path.is_file() else (),
            command=run_facts["command"],
            versions=run_facts["versions"],
            counts={"buses": feeder.n_bus, "branches": feeder.n_branch},
            load_kw=float(feeder.p_load_kw.sum()),
            base_kv=feeder.base_kv,
            findings=imported.findings,
            effects=(),
            comparisons=(comparison(imported, feeder),),
            ratings=ratings_by_kind(feeder),
            notes=imported.notes,
        )


@dataclass(frozen=True)
class ImportPandapower(_Import):
    """Read a balanced feeder from a pandapower net.

    Writes the feeder as a folder of tables with a report, and compares the voltages.

    Reading a JSON file imports and runs none of the code that it names (docs/import.md). The import reports an error
    for more than eight loops, several sources, voltage-controlling generators and DC lines.
    """

    net: tyro.conf.Positional[str]
    """Net: a function of pandapower.networks such as case33bw, a SimBench code, a JSON file or a MATPOWER case (.m)."""
    arguments: tuple[str, ...] = ()
    """Arguments of the function of pandapower.networks, for example with_der=all."""
    fix_generators: bool = False
    """Replace voltage-controlling generators by constant loads with their power from pandapower's power flow."""
    trust: bool = False
    """Let pandapower read the file, which imports and runs code that the file names. Use it only for trusted files."""

    @property
    def origin(self) -> str:
        """The net."""
        return self.net

    def read(self, allow: list[str]) -> ImportedFeeder:
        """Read the net, or the case if the path ends in .m."""
        if not self.net.strip():
            raise ValueError(
                "net: must not be empty; give a function of pandapower.networks, a SimBench code or a file"
            )
        if self.net.endswith(".m"):
            case = ImportMatpower(
                file=Path(self.net),
                out=self.out,
                source=self.source,
                bus_names=self.bus_names,
                fix_generators=self.fix_generators,
            )
            return case.read(allow)
        from dcgrid_env.apps.importers.pandapower import read_pandapower

        return read_pandapower(
            self.net,
            arguments=_arguments(self.arguments),
            at=self.source,
            allow=allow,
            fix_generators=self.fix_generators,
            bus_names=self.bus_names,
            trust=self.trust,
        )


@dataclass(frozen=True)
class ImportMatpower(_Import):
    """Read a balanced feeder from a MATPOWER case file.

    Writes the feeder as a folder of tables with a report, and compares the voltages.

    The file is not executed. The import evaluates arithmetic on its tables and reports an error with the line for any
    other code (docs/import.md).
    """

    file: tyro.conf.Positional[Path]
    """Case file (.m)."""
    per_phase: bool = False
    """Multiply powers and base power by three, for files with values per phase."""
    fix_generators: bool = False
    """Replace voltage-controlling generators by constant loads with their power from MATPOWER's power flow."""

    @property
    def origin(self) -> str:
        """The file."""
        return str(self.file)

    def read(self, allow: list[str]) -> ImportedFeeder:
        """Read the case."""
        from dcgrid_env.apps.importers.matpower import read_matpower

        return read_matpower(
            self.file,
            source=self.source,
            allow=allow,
            per_phase=self.per_phase,
            fix_generators=self.fix_generators,
            bus_names=self.bus_names,
        )


@dataclass(frozen=True)
class ImportPowerGridModel(_Import):
    """Read a balanced feeder from a power-grid-model JSON file.

    Writes the feeder as a folder of tables with a report, and compares the voltages.

    The import reports an error that names the elements it cannot represent (docs/import.md).
    """

    file: tyro.conf.Positional[Path]
    """Input data file (.json)."""
    frequency_hz: float = 50.0
    """System frequency, Hz, which the charging of lines depends on."""

    @property
    def origin(self) -> str:
        """The file."""
        return str(self.file)

    def read(self, allow: list[str]) -> ImportedFeeder:
        """Read the file."""
        from dcgrid_env.apps.importers.power_grid_model import read_power_grid_model

        return read_power_grid_model(
            self.file, source=self.source, allow=allow, frequency_hz=self.frequency_hz, bus_names=self.bus_names
        )


def comparison(imported: ImportedFeeder, feeder: Feeder) -> Comparison:
    """Compare the voltages by dcgrid with those by the source's solver."""
    from dcgrid_env.powerflow import distflow

    solution = distflow(feeder, feeder.p_load_kw, feeder.q_load_kvar - feeder.capacitor_kvar)
    ours = dict(zip(feeder.bus_ids, solution.v_pu.tolist(), strict=True)) if solution.converged else None
    base_kv = np.full(feeder.n_bus, feeder.base_kv) if feeder.bus_base_kv is None else feeder.bus_base_kv
    base_v = {bus: 1000.0 * float(kv) for bus, kv in zip(feeder.bus_ids, base_kv, strict=True)}
    return compared("voltage magnitudes", imported.solver, ours, imported.v_pu, base_v)


def _arguments(words: tuple[str, ...]) -> dict[str, Any]:
    """Return arguments by name; a value is parsed as JSON, or else kept as text."""
    arguments = {}
    for word in words:
        name, sign, text = word.partition("=")
        if not sign or not name.isidentifier():
            raise ValueError(f"arguments: must be NAME=VALUE, such as with_der=all, got {word!r}")
        arguments[name] = _value(text)
    return arguments


def _value(text: str) -> Any:
    try:
        return parse_json(text, "arguments", ValueError, "")
    except ValueError:
        return text


def _write_merged(imported: ImportedFeeder, folder: Path) -> None:
    """Write the buses that switches merged, if there are any."""
    import csv
    import io

    from dcgrid_env.core.files import write_text

    rows = [(source_bus, bus) for source_bus, bus in imported.bus_of.items() if source_bus != bus]
    if rows:
        text = io.StringIO()
        csv.writer(text, lineterminator="\n").writerows([("source_bus", "bus"), *rows])
        write_text(folder / MERGED, text.getvalue())

"""The commands ``dcgrid import pandapower``, ``matpower`` and ``power-grid-model``."""

from __future__ import annotations

import json
from abc import abstractmethod
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import tyro

from dcgrid_env.cli.command import Command
from dcgrid_env.cli.opendss_import import CLOSE_PU, findings_table
from dcgrid_env.cli.settings import check_folder
from dcgrid_env.cli.terminal import plain_console, say

if TYPE_CHECKING:
    from dcgrid_env import Feeder
    from dcgrid_env.grid.formats.bus_branch import ImportedFeeder

_SHOWN = 5
MERGED = "merged_buses.csv"
"""File beside the tables that says at which bus the source's buses are that switches have joined."""


@dataclass(frozen=True, kw_only=True)
class _Import(Command):
    """What the imports of balanced grids have in common."""

    out: Path
    """Folder for the tables; it must be new or empty."""
    source: str | None = None
    """Bus of the source whose island is taken, where the grid has several."""
    allow: str = ""
    """Kinds of elements, separated by commas, that may be left out although something is lost: controller,load."""
    bus_names: bool = False
    """Call buses by their names in the file rather than by their numbers."""

    @abstractmethod
    def read(self, allow: list[str]) -> ImportedFeeder:
        """Read the grid."""

    def run(self) -> None:
        """Read, reduce, solve, say what became of each element, and write; nothing is written on an error."""
        from dcgrid_env import Feeder
        from dcgrid_env.core.files import whole_folder

        if self.out.exists() and (not self.out.is_dir() or any(self.out.iterdir())):
            raise ValueError(f"out: {self.out} is there and not an empty folder; choose another --out")
        check_folder(self.out)
        imported = self.read([kind.strip() for kind in self.allow.split(",") if kind.strip()])
        feeder = Feeder.from_network(imported.network)
        said = compared(imported, feeder)
        with whole_folder(self.out) as folder:
            feeder.to_csv(folder)
            _write_merged(imported, folder)
        console = plain_console()
        console.print(findings_table(imported.findings))
        for line in (*imported.notes, *said):
            say(console, line)
        say(console, f"wrote {self.out}: {feeder.n_bus} buses, {feeder.n_branch} branches, {_load(feeder)}")


@dataclass(frozen=True)
class ImportPandapower(_Import):
    """Read a balanced feeder from a pandapower net.

    Writes the feeder as a folder of tables and compares the voltages.

    A JSON file is read without importing or calling what it names (docs/import.md). The import
    refuses these elements by name: loops, several sources, generators that keep a voltage, DC lines.
    """

    net: tyro.conf.Positional[str]
    """A network of pandapower.networks such as case33bw, a SimBench code, a JSON file, or a MATPOWER case (.m)."""
    arguments: tuple[str, ...] = ()
    """What a network of pandapower.networks is made with: with_der=all."""
    fix_generators: bool = False
    """Make generators that keep a voltage constant loads, of the power that pandapower's power flow gives them."""
    trust: bool = False
    """Let pandapower read the file, which imports and makes what the file names."""

    def read(self, allow: list[str]) -> ImportedFeeder:
        """Read the net, or the case where the path ends in .m."""
        if not self.net.strip():
            raise ValueError("net is empty; give a network of pandapower.networks, a SimBench code or a file")
        if self.net.endswith(".m"):
            case = ImportMatpower(
                file=Path(self.net),
                out=self.out,
                source=self.source,
                bus_names=self.bus_names,
                fix_generators=self.fix_generators,
            )
            return case.read(allow)
        from dcgrid_env.grid.formats.pandapower import read_pandapower

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

    Writes the feeder as a folder of tables and compares the voltages.

    The file is not executed: arithmetic on its own tables is understood, all other code is refused with its line
    (docs/import.md).
    """

    file: tyro.conf.Positional[Path]
    """The case file (.m)."""
    per_phase: bool = False
    """The file's powers and base power are of one phase: take them three times."""
    fix_generators: bool = False
    """Make generators that keep a voltage constant loads, of the power that MATPOWER's power flow gives them."""

    def read(self, allow: list[str]) -> ImportedFeeder:
        """Read the case."""
        from dcgrid_env.grid.formats.matpower import read_matpower

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

    Writes the feeder as a folder of tables and compares the voltages.

    The import refuses by name the elements that it cannot represent (docs/import.md).
    """

    file: tyro.conf.Positional[Path]
    """The file of input data (.json)."""
    frequency_hz: float = 50.0
    """Frequency of the system, at which the charging of lines is reckoned."""

    def read(self, allow: list[str]) -> ImportedFeeder:
        """Read the file."""
        from dcgrid_env.grid.formats.power_grid_model import read_power_grid_model

        return read_power_grid_model(
            self.file, source=self.source, allow=allow, frequency_hz=self.frequency_hz, bus_names=self.bus_names
        )


def compared(imported: ImportedFeeder, feeder: Feeder) -> list[str]:
    """Lines that say how far our voltages are from those of the source's solver, and at which buses most.

    FeederError where they are apart though nothing is said to be lost.
    """
    from dcgrid_env import FeederError
    from dcgrid_env.powerflow import distflow

    ours = distflow(feeder, feeder.p_load_kw, feeder.q_load_kvar - feeder.capacitor_kvar)
    found = {imported.solver: bool(imported.v_pu), "our power flow": bool(ours.converged)}
    failed = [name for name, converged in found.items() if not converged]
    if failed:
        return [f"{' and '.join(failed)} found no solution, so that voltages are not compared"]
    apart = {
        bus: abs(float(v) - imported.v_pu[bus])
        for bus, v in zip(feeder.bus_ids, ours.v_pu, strict=True)
        if bus in imported.v_pu
    }
    worst = sorted(apart, key=lambda bus: -apart[bus])[:_SHOWN]
    where = ", ".join(f"{bus} ({apart[bus]:.1e})" for bus in worst)
    lines = [f"largest voltage difference to {imported.solver}: {apart[worst[0]]:.1e} p.u.; most at {where}"]
    if not apart[worst[0]] <= CLOSE_PU:
        if not any(row.fate == "lost" for row in imported.findings):
            raise FeederError(
                f"{lines[0]}: more than {CLOSE_PU:g} though nothing is said to be lost, so that the tables would be "
                "wrong; nothing is written: report the file"
            )
        lines.append(f"the voltages differ by more than {CLOSE_PU:g} p.u.: what is lost moves them")
    return lines


def _arguments(words: tuple[str, ...]) -> dict[str, Any]:
    """Arguments by name; a value is JSON's, or the text that it is."""
    made = {}
    for word in words:
        name, sign, text = word.partition("=")
        if not sign or not name.isidentifier():
            raise ValueError(f"arguments: {word!r} is no NAME=VALUE, such as with_der=all")
        try:
            made[name] = json.loads(text)
        except json.JSONDecodeError:
            made[name] = text
    return made


def _write_merged(imported: ImportedFeeder, folder: Path) -> None:
    """Say which buses switches have joined, where there are any."""
    import csv
    import io

    from dcgrid_env.core.files import write_text

    rows = [(own, bus) for own, bus in imported.bus_of.items() if own != bus]
    if rows:
        text = io.StringIO()
        csv.writer(text, lineterminator="\n").writerows([("source_bus", "bus"), *rows])
        write_text(folder / MERGED, text.getvalue())


def _load(feeder: Feeder) -> str:
    return f"{feeder.p_load_kw.sum():.1f} kW at {feeder.base_kv:g} kV"

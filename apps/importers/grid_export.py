"""The commands ``dcgrid export pandapower``, ``matpower`` and ``power-grid-model``."""

from __future__ import annotations

import tempfile
from abc import abstractmethod
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import tyro

from dcgrid_env.core.commands.command import Command
from dcgrid_env.core.commands.terminal import plain_console, say

if TYPE_CHECKING:
    from dcgrid_env import Feeder
    from dcgrid_env.apps.importers.bus_branch import ImportedFeeder


@dataclass(frozen=True)
class _Export(Command):
    """Base class of the exports of balanced feeders."""

    feeder: tyro.conf.Positional[str]
    """Feeder to export: the name of a bundled feeder or the folder of your feeder."""
    out: Path
    """Output file. It must not exist yet."""

    @abstractmethod
    def write(self, feeder: Feeder, path: Path) -> None:
        """Write the file."""

    @abstractmethod
    def read_back(self, path: Path) -> ImportedFeeder:
        """Read the file back."""

    def run(self) -> None:
        """Write the file, read it back and compare voltages with the other program's; write nothing on an error."""
        from dcgrid_env.apps.importers.grid_import import comparison
        from dcgrid_env.apps.importers.import_record import CLOSE_PU
        from dcgrid_env.core.files import write_bytes

        if self.out.exists():
            raise ValueError(f"out: must be a new file, got {self.out}, which exists; choose another --out")
        feeder = _balanced(self.feeder)
        with tempfile.TemporaryDirectory() as folder:
            file = Path(folder) / self.out.name
            self.write(feeder, file)
            said = comparison(self.read_back(file), feeder)
            if said.largest and not said.is_close:
                raise ValueError(f"{said}: must be at most {CLOSE_PU:g}; nothing was written, please report the feeder")
            write_bytes(self.out, file.read_bytes())
        console = plain_console()
        say(console, str(said))
        say(console, f"wrote {self.out}: {feeder.n_bus} buses, {feeder.n_branch} branches")


@dataclass(frozen=True)
class ExportPandapower(_Export):
    """Write a balanced feeder as the JSON of a pandapower net."""

    def write(self, feeder: Feeder, path: Path) -> None:
        """Write the net."""
        from dcgrid_env.apps.importers.pandapower import write_pandapower

        write_pandapower(feeder, path)

    def read_back(self, path: Path) -> ImportedFeeder:
        """Read the net."""
        from dcgrid_env.apps.importers.pandapower import read_pandapower

        return read_pandapower(path, bus_names=True)


@dataclass(frozen=True)
class ExportMatpower(_Export):
    """Write a balanced feeder as a MATPOWER case file."""

    def write(self, feeder: Feeder, path: Path) -> None:
        """Write the case."""
        from dcgrid_env.apps.importers.matpower import write_matpower

        write_matpower(feeder, path)

    def read_back(self, path: Path) -> ImportedFeeder:
        """Read the case; bus ids that are not numbers are stored as names."""
        from dcgrid_env.apps.importers.matpower import read_matpower

        return read_matpower(path, bus_names="mpc.bus_name" in path.read_text(encoding="utf-8"))


@dataclass(frozen=True)
class ExportPowerGridModel(_Export):
    """Write a balanced feeder as power-grid-model JSON."""

    def write(self, feeder: Feeder, path: Path) -> None:
        """Write the data."""
        from dcgrid_env.apps.importers.power_grid_model import write_power_grid_model

        write_power_grid_model(feeder, path)

    def read_back(self, path: Path) -> ImportedFeeder:
        """Read the data."""
        from dcgrid_env.apps.importers.power_grid_model import read_power_grid_model

        return read_power_grid_model(path, bus_names=True)


def _balanced(name: str) -> Feeder:
    """Return a feeder by name or folder; raise ValueError if it does not exist or has three phases."""
    from dcgrid_env import Feeder
    from dcgrid_env.scenario.serialization import feeder_from_data

    if not name.strip():
        raise ValueError("feeder: must not be empty; give a feeder's name or folder")
    feeder = feeder_from_data(name)
    if not isinstance(feeder, Feeder):
        raise ValueError(
            f"feeder: must be balanced, got {name} with three phases; the formats only support balanced feeders"
        )
    return feeder

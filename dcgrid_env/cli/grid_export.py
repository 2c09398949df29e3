"""The commands ``dcgrid export pandapower``, ``matpower`` and ``power-grid-model``."""

from __future__ import annotations

import tempfile
from abc import abstractmethod
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import tyro

from dcgrid_env.cli.command import Command
from dcgrid_env.cli.terminal import plain_console, say

if TYPE_CHECKING:
    from dcgrid_env import Feeder
    from dcgrid_env.grid.formats.bus_branch import ImportedFeeder


@dataclass(frozen=True)
class _Export(Command):
    """What the exports of balanced feeders have in common."""

    feeder: tyro.conf.Positional[str]
    """A feeder's name, or the folder of one's own."""
    out: Path
    """The file to be written; it must be new."""

    @abstractmethod
    def write(self, feeder: Feeder, path: Path) -> None:
        """Write the file."""

    @abstractmethod
    def read_back(self, path: Path) -> ImportedFeeder:
        """Read the file again."""

    def run(self) -> None:
        """Write the file, read it again and say how far the other program's voltages are; nothing is written on an
        error."""
        from dcgrid_env.cli.grid_import import compared
        from dcgrid_env.core.files import write_bytes

        if self.out.exists():
            raise ValueError(f"out: {self.out} is there; choose another --out")
        feeder = _balanced(self.feeder)
        with tempfile.TemporaryDirectory() as folder:
            file = Path(folder) / self.out.name
            self.write(feeder, file)
            said = compared(self.read_back(file), feeder)
            write_bytes(self.out, file.read_bytes())
        console = plain_console()
        for line in said:
            say(console, line)
        say(console, f"wrote {self.out}: {feeder.n_bus} buses, {feeder.n_branch} branches")


@dataclass(frozen=True)
class ExportPandapower(_Export):
    """Write a balanced feeder as the JSON of a pandapower net."""

    def write(self, feeder: Feeder, path: Path) -> None:
        """Write the net."""
        from dcgrid_env.grid.formats.pandapower import write_pandapower

        write_pandapower(feeder, path)

    def read_back(self, path: Path) -> ImportedFeeder:
        """Read the net."""
        from dcgrid_env.grid.formats.pandapower import read_pandapower

        return read_pandapower(path, bus_names=True)


@dataclass(frozen=True)
class ExportMatpower(_Export):
    """Write a balanced feeder as a MATPOWER case file."""

    def write(self, feeder: Feeder, path: Path) -> None:
        """Write the case."""
        from dcgrid_env.grid.formats.matpower import write_matpower

        write_matpower(feeder, path)

    def read_back(self, path: Path) -> ImportedFeeder:
        """Read the case; buses that are no numbers stand there as names."""
        from dcgrid_env.grid.formats.matpower import read_matpower

        return read_matpower(path, bus_names="mpc.bus_name" in path.read_text(encoding="utf-8"))


@dataclass(frozen=True)
class ExportPowerGridModel(_Export):
    """Write a balanced feeder as power-grid-model JSON."""

    def write(self, feeder: Feeder, path: Path) -> None:
        """Write the data."""
        from dcgrid_env.grid.formats.power_grid_model import write_power_grid_model

        write_power_grid_model(feeder, path)

    def read_back(self, path: Path) -> ImportedFeeder:
        """Read the data."""
        from dcgrid_env.grid.formats.power_grid_model import read_power_grid_model

        return read_power_grid_model(path, bus_names=True)


def _balanced(name: str) -> Feeder:
    """A feeder by name or folder; ValueError for one that is not there or has three phases."""
    from dcgrid_env import Feeder
    from dcgrid_env.scenario.plain import feeder_from_plain

    if not name.strip():
        raise ValueError("feeder is empty; give a feeder's name or the folder of one's own")
    feeder = feeder_from_plain(name)
    if not isinstance(feeder, Feeder):
        raise ValueError(
            f"feeder: {name} has three phases, and the formats hold balanced feeders; choose a balanced one"
        )
    return feeder

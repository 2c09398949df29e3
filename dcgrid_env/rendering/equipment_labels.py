"""What the map says of a three-phase feeder's regulators and capacitor banks: taps by phase, on or off."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.text import Annotation

from dcgrid_env.devices.capacitor_bank.capacitor_banks import CapacitorBanks
from dcgrid_env.devices.capacitor_bank.threshold_set_points import ThresholdSetPoints
from dcgrid_env.devices.tap_changer.regulator_set_points import RegulatorSetPoints
from dcgrid_env.devices.tap_changer.tap_changers import TapChangers
from dcgrid_env.grid import ThreePhaseFeeder
from dcgrid_env.rendering.feeder_map import FloatArray, Room
from dcgrid_env.scenario.scenario import Scenario

BANK_COLOURS = ("#6A3D9A", "#A6561C", "#1A1A1A", "#7A7A00")
"""Colours of regulator banks on the map and in the curves of their taps; they repeat after four."""
CAPACITOR = "#1F5F4A"
SIZE_PT = 7.0


class Bank(NamedTuple):
    """Regulators that stand together."""

    name: str
    bus: int
    """Position in ``bus_ids`` of the bus that they feed."""
    rows: tuple[int, ...]
    """Their rows in the regulators' table, by phase."""
    colour: str


def banks_of(feeder: ThreePhaseFeeder) -> list[Bank]:
    """The banks of a feeder's regulators, in the order of their table."""
    table = feeder.network.regulator
    rows: dict[tuple[str, str], list[int]] = {}
    for row, of_bank in enumerate(zip(table.bank, table.to_bus, strict=True)):
        rows.setdefault(of_bank, []).append(row)
    return [
        Bank(
            name,
            feeder.index(bus),
            tuple(sorted(there, key=lambda row: table.phases[row])),
            BANK_COLOURS[i % len(BANK_COLOURS)],
        )
        for i, ((name, bus), there) in enumerate(rows.items())
    ]


class EquipmentLabels:
    """Labels next to the buses of regulators and capacitor banks; a text changes with its tap or bank."""

    def __init__(self, ax: Axes, scenario: Scenario):
        feeder: Any = scenario.feeder
        table = feeder.network.regulator
        self.banks, self.phases = banks_of(feeder), table.phases
        self.capacitors: list[str] = [str(name) for name in feeder.network.capacitor.name]
        self.agents = _agents(scenario)
        self.connected = scenario.background.capacitors
        self._buses = [bank.bus for bank in self.banks]
        self._buses += [feeder.index(bus) for bus in feeder.network.capacitor.bus]
        colours = [bank.colour for bank in self.banks] + [CAPACITOR] * len(self.capacitors)
        self.labels = [self._label(ax, colour) for colour in colours]
        longest = -np.maximum(np.abs(table.tap_min), np.abs(table.tap_max))
        self._longest = self._texts(longest, ["lost"] * len(self.capacitors))

    def _label(self, ax: Axes, colour: str) -> Annotation:
        look: Any = {"boxstyle": "round,pad=0.2", "facecolor": "white", "edgecolor": colour, "linewidth": 0.8}
        line: Any = {"arrowstyle": "-", "color": colour, "linewidth": 0.8, "shrinkA": 0.0}
        label = ax.annotate(
            "", (0.0, 0.0), (0.0, 0.0), textcoords="offset points", ha="center", va="center", bbox=look, arrowprops=line
        )
        label.set(fontsize=SIZE_PT, color=colour, zorder=6.5)  # the names above it keep clear of its line
        return label

    def place(self, xy: FloatArray, room: Room, radius_pt: float) -> None:
        """Put each label next to its bus, where its longest text covers least; ``radius_pt`` is that of a bus."""
        for label, text, bus in zip(self.labels, self._longest, self._buses, strict=True):
            lines = text.split("\n")
            label.xy = tuple(xy[bus])
            letters, height = max(map(len, lines)) + 1, 1.2 * len(lines) + 0.6  # with the frame around it
            label.set_position(tuple(room.take(bus, letters, SIZE_PT, height, led=True)))
            line: Any = label.arrow_patch
            line.shrinkB = radius_pt

    def show(self, tap: np.ndarray, on: np.ndarray, lost: np.ndarray) -> bool:
        """Say the taps, (n_regulator,), and which banks are on and which lost, (n_capacitor,).

        Returns whether that changes a text.
        """
        runs = (on > 0.5) & self.connected
        states = ["lost" if gone else "on" if runs_now else "off" for runs_now, gone in zip(runs, lost, strict=True)]
        texts = self._texts(tap, states)
        if texts == [label.get_text() for label in self.labels]:
            return False
        for label, text in zip(self.labels, texts, strict=True):
            label.set_text(text)
        for label, state in zip(self.labels[len(self.banks) :], states, strict=True):
            chip: Any = label.get_bbox_patch()
            chip.set_facecolor(CAPACITOR if state == "on" else "white")
            label.set_color("white" if state == "on" else CAPACITOR)
        return True

    def _texts(self, tap: Any, states: list[str]) -> list[str]:
        texts = []
        for bank in self.banks:
            taps = " ".join(f"{self.phases[row]}{signed(tap[row])}" for row in bank.rows)
            agents = " ".join(self.agents["tap", row] for row in bank.rows if ("tap", row) in self.agents)
            texts.append(f"{bank.name} {taps}" + (f"\n{agents}" if agents else ""))
        for row, (name, state) in enumerate(zip(self.capacitors, states, strict=True)):
            texts.append(f"{name} {state}" + (f"\n{self.agents['on', row]}" if ("on", row) in self.agents else ""))
        return texts


def signed(tap: float) -> str:
    """A tap with its sign, 0 without."""
    return f"{tap:+.0f}".replace("-", "\N{MINUS SIGN}") if round(tap) else "0"


def _agents(scenario: Scenario) -> dict[tuple[str, int], str]:
    """Id of the agent that commands a regulator, by ("tap", row), or a capacitor bank, by ("on", row).

    An agent of a bank's set point is that of the bank's first regulator.
    """
    agents, names = {}, iter(scenario.agents)
    for device in scenario.devices:
        device_names = [next(names) for _ in range(device.count)]
        if isinstance(device, TapChangers | CapacitorBanks):
            field = "tap" if isinstance(device, TapChangers) else "on"
            agents |= {(field, row): name for row, name in zip(device.rows, device_names, strict=True)}
        elif isinstance(device, RegulatorSetPoints | ThresholdSetPoints):
            field = "tap" if isinstance(device, RegulatorSetPoints) else "on"
            agents |= {(field, rows[0]): name for rows, name in zip(device.members, device_names, strict=True)}
    return agents

"""The left half of the picture of a three-phase feeder: its map by phase, its unbalance, taps and capacitor banks."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.font_manager import FontProperties
from matplotlib.patches import Patch

from dcgrid_env.powerflow import three_phase_nodes
from dcgrid_env.rendering.bus_positions import positions
from dcgrid_env.rendering.equipment_labels import CAPACITOR, EquipmentLabels
from dcgrid_env.rendering.feeder_map import INK
from dcgrid_env.rendering.history import History
from dcgrid_env.rendering.lettering import Lettering
from dcgrid_env.rendering.map_panel import MIDDLE, MapPart, Panel, by_rows, mark
from dcgrid_env.rendering.phase_map import WORST, PhaseMap, rim, sector
from dcgrid_env.scenario.scenario import Scenario

_ORDER = (
    "a top, b right, c left", "data centre; arc: clock", "halo: backlog", "substation",
    "outside limits", "largest unbalance", "regulator: taps", "capacitor on",
)  # fmt: skip
"""Signs in the order of the key; other kinds of devices follow the signs of the first row, by their names."""

_SPLIT = 0.165
"""Where the map ends and its colour bar begins, a share of the height."""
_NO_UNBALANCE = 1e-6
"""Factor below which there is none but rounding."""


class PhaseMapPart(MapPart):
    """The left half: title, feeder by phase, colour bar, and what the signs mean."""

    spacing = 0.8
    bottom = 0.022
    feeder: PhaseMap

    def __init__(self, figure: Figure, scenario: Scenario):
        feeder: Any = scenario.feeder
        self.three_phase_buses = feeder.node_bus[three_phase_nodes(feeder)[:, 0]]
        """Position in ``bus_ids`` of each bus with an unbalance."""
        super().__init__(figure, scenario)
        self.title.xy, self.subtitle.xy = (0.015, 0.965), (0.015, 0.932)
        self.more = Lettering(figure, (0.015, 0.905), FontProperties(family="DejaVu Sans", size=10), INK)
        self.moving.append(self.more)
        drawn, *below = self.panels[0].still
        # Taps may move in every frame: the colour bar and the key need not be drawn anew with them.
        self.panels = [Panel((0.0, _SPLIT, MIDDLE, 1.0), [drawn]), Panel((0.0, 0.0, MIDDLE, _SPLIT), below)]

    def _map(self, ax: Axes, names: tuple[list[str], list[str]]) -> PhaseMap:
        s = self.scenario
        drawn = PhaseMap(ax, s.feeder, positions(s.feeder), s.cost.band_pu, names)
        self.equipment = EquipmentLabels(ax, s)
        drawn.label_equipment(self.equipment)
        return drawn

    def _signs(self) -> list[tuple[Any, str]]:
        signs = {text: sign for sign, text in super()._signs()}
        signs["outside limits"] = mark(rim(0), 12, "black", 1.8)
        signs["outside limits"].set_fillstyle("none")
        signs["a top, b right, c left"] = tuple(mark(sector(phase), 12) for phase in range(3))
        if len(self.three_phase_buses):
            signs["largest unbalance"] = mark("o", 11, WORST["edgecolors"], 2.0)
        if self.equipment.banks:
            signs["regulator: taps"] = mark("D", 8)
        if self.equipment.capacitors:
            signs["capacitor on"] = Patch(facecolor=CAPACITOR, edgecolor=CAPACITOR)
        return by_rows(sorted(((sign, text) for text, sign in signs.items()), key=lambda entry: _place(entry[1])))

    def update(self, history: History) -> list[Panel]:
        """Show the last step; the panels in which something moved that was thought to be still."""
        phases: Any = history.phases
        changed = super().update(history)
        step = history.last
        said = self.equipment.show(phases.tap[step], phases.on[step], history.lost_banks(self.scenario))
        self.more.set_text(";   ".join((*self._unbalance(phases.unbalance[step]), *self._moves(phases.moves[step]))))
        return self.panels[:1] if changed or said else []

    def _unbalance(self, factor: np.ndarray) -> list[str]:
        """Mark the bus with the largest unbalance, and return the text with its value."""
        if not len(factor):
            self.feeder.mark_worst(None)
            return ["no three-phase bus"]
        k = int(np.argmax(np.nan_to_num(factor)))
        worst = int(self.three_phase_buses[k]) if factor[k] > _NO_UNBALANCE else None
        self.feeder.mark_worst(worst)
        if worst is None:
            return ["no unbalance"]
        return [f"largest unbalance {100.0 * factor[k]:.2f} % at bus {self.scenario.feeder.bus_ids[worst]}"]

    def _moves(self, moves: np.ndarray) -> list[str]:
        """How often regulators and capacitor banks have moved since t = 0."""
        said = [f"taps moved: {moves[0]}"] if self.equipment.banks else []
        return said + ([f"capacitors switched: {moves[1]}"] if self.equipment.capacitors else [])


def _place(sign: str) -> float:
    return _ORDER.index(sign) if sign in _ORDER else 3.5

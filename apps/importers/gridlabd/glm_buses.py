"""Buses of a GridLAB-D model, their base voltages, and the names that OpenDSS knows them by."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass, field

from dcgrid_env.apps.importers.gridlabd.glm_model import NODES, TRIPLEX, Model, wrong
from dcgrid_env.apps.importers.gridlabd.glm_text import GlmObject
from dcgrid_env.apps.importers.import_report import Report
from dcgrid_env.grid.topology import FeederError

LINES = ("overhead_line", "underground_line", "triplex_line")
SWITCHES = ("switch", "fuse", "recloser", "sectionalizer")
LINKS = (*LINES, *SWITCHES, "transformer", "regulator")
"""Classes of objects that connect two buses."""
_NODES = {"A": 1, "B": 2, "C": 3, "1": 1, "2": 2}
_CLOSE = 0.05
"""Relative difference up to which a bus's nominal voltage is taken instead of the one that transformers give."""


@dataclass
class Names:
    """Unique names without the characters that OpenDSS reserves."""

    report: Report
    _used: dict[tuple[str, str], int] = field(default_factory=dict)

    def unique(self, kind: str, name: str) -> str:
        """A name for an element of a class, reported if it differs from the model's in more than case."""
        base = re.sub(r"[^a-z0-9_\-]", "_", name.lower())
        unique_name, k = base, self._used.get((kind, base), 0)
        while (kind, unique_name) in self._used:
            k += 1
            unique_name = f"{base}_{k}"
        self._used[kind, base], self._used[kind, unique_name] = k, 1
        if unique_name != name.lower():
            self.report.add("nothing lost", kind, f"{name} is {unique_name}", "the name has other characters here")
        return unique_name


class Buses:
    """Buses of a model.

    Attributes
    ----------
    swing
        The object of the source's bus.
    base_v
        Line-to-neutral base voltage, V, by bus.
    shift_deg
        Angle by which transformers turn the voltages of each bus relative to the source, degrees.
    """

    def __init__(self, model: Model, names: Names) -> None:
        self._model = model
        self._names: dict[int, str] = {}
        tops = [item for item in model.of_kind(*NODES) if model.bus_object(item) is item]
        for item in tops:
            if item.kind == "capacitor":
                wrong(item, "parent", "is missing; name the node that the capacitor is at")
            self._names[id(item)] = names.unique("bus", item.name)
        types = {id(item): model.keyword(item, "node", "bustype", "PQ") for item in tops}
        for item in tops:
            if types[id(item)] == "PV":
                wrong(item, "bustype", "keeps a voltage, which cannot be represented; write PQ and give its power")
        swings = [item for item in tops if types[id(item)].startswith("SWING")]
        if len(swings) != 1:
            sources = f"the buses {', '.join(item.name for item in swings)} as sources" if swings else "no source"
            raise FeederError(f"{model.file.path}: the model has {sources}; set bustype SWING at exactly one node")
        self.swing = swings[0]
        self.objects = {self.name(item): item for item in tops}
        self.base_v: dict[str, float] = {}
        self.shift_deg: dict[str, float] = {}
        self._follow_links()

    def name(self, item: GlmObject) -> str:
        """Bus of a node, meter, load or capacitor."""
        return self._names[id(self._model.bus_object(item))]

    def ends(self, link: GlmObject) -> tuple[str, str]:
        """Buses of a link."""
        first, second = (self.name(self._model.reference(link, end, *NODES)) for end in ("from", "to"))
        if first == second:
            wrong(link, "to", "is the bus that it comes from")
        return first, second

    def terminal(self, bus: str, phases: str) -> str:
        """A bus with the nodes of phases, as OpenDSS writes it."""
        return ".".join([bus, *(str(_NODES[phase]) for phase in phases)])

    def nominal_v(self, bus: str) -> float:
        """Line-to-neutral nominal voltage of a bus, V, which its children have too."""
        item = self.objects[bus]
        default = 120.0 if item.kind in TRIPLEX else None
        return self._model.positive(item, "nominal_voltage", "voltage", default)

    def _follow_links(self) -> None:
        """Give each bus its base voltage and shift, from the source on; those without supply have their nominal one."""
        links: dict[str, list[tuple[str, float, float]]] = {}
        for link in self._model.of_kind(*LINKS):
            first, second = self.ends(link)
            is_open = self._model.keyword(link, "link", "status", "CLOSED") == "OPEN"
            if link.kind in ("transformer", "regulator") and is_open:
                wrong(link, "status", "cannot be represented; add an open switch in series")
            ratio, shift_deg = 1.0, 0.0
            if link.kind == "transformer":
                ratio = turns_ratio(self._model, link)
                if connection(self._model, link) == "DELTA_GWYE":
                    shift_deg = -30.0 if ratio >= 1.0 else 30.0
            links.setdefault(first, []).append((second, 1.0 / ratio, shift_deg))
            links.setdefault(second, []).append((first, ratio, -shift_deg))
        start = self.name(self.swing)
        self.base_v[start], self.shift_deg[start] = self.nominal_v(start), 0.0
        queue = [start]
        for bus in queue:
            for other, factor, shift_deg in links.get(bus, ()):
                if other not in self.base_v:
                    volts, nominal_v = factor * self.base_v[bus], self.nominal_v(other)
                    self.base_v[other] = nominal_v if math.isclose(nominal_v, volts, rel_tol=_CLOSE) else volts
                    self.shift_deg[other] = self.shift_deg[bus] + shift_deg
                    queue.append(other)
        for bus in self.objects:
            self.base_v.setdefault(bus, self.nominal_v(bus))
            self.shift_deg.setdefault(bus, 0.0)


def connection(model: Model, transformer: GlmObject) -> str:
    """Connection of a transformer; FeederError for one that cannot be represented."""
    config = model.reference(transformer, "configuration", "transformer_configuration")
    return model.keyword(config, "transformer_configuration", "connect_type")


def turns_ratio(model: Model, transformer: GlmObject) -> float:
    """Primary over secondary voltage."""
    config = model.reference(transformer, "configuration", "transformer_configuration")
    return model.positive(config, "primary_voltage", "voltage") / model.positive(config, "secondary_voltage", "voltage")

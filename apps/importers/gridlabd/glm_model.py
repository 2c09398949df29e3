"""Objects of a GridLAB-D model by name, and their values in GridLAB-D's units."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import NoReturn

from dcgrid_env.apps.importers.gridlabd.glm_text import GlmFile, GlmObject
from dcgrid_env.apps.importers.gridlabd.glm_values import number
from dcgrid_env.apps.importers.gridlabd.glm_words import ENUMERATIONS, keyword, phase_letters
from dcgrid_env.grid.topology import FeederError

TRIPLEX = ("triplex_node", "triplex_meter", "triplex_load")
NODES = ("node", "meter", "load", "capacitor", *TRIPLEX)
"""Classes of objects that are a bus, or a part of their parent's bus."""


def wrong(item: GlmObject, name: str, text: str) -> NoReturn:
    """Raise a FeederError that names file, line, object, property and value."""
    entry = item.properties.get(name)
    where, value = (entry.where, f" {entry.text!r}") if entry else (item.where, "")
    raise FeederError(f"{where}: {item.kind} {item.name}: {name}{value} {text}")


@dataclass
class Model:
    """Objects of a file with their references resolved.

    Attributes
    ----------
    file
        The file.
    """

    file: GlmFile
    _by_name: dict[str, GlmObject] = field(default_factory=dict)

    def __post_init__(self) -> None:
        for item in self.file.objects:
            for name in {item.name, f"{item.kind}:{item.number}"}:
                other = self._by_name.setdefault(name, item)
                if other is not item:
                    raise FeederError(
                        f"{item.where}: {item.kind} {item.name}: {other.where} has an object of this name; rename one"
                    )

    def __contains__(self, name: str) -> bool:
        return name in self._by_name

    def of_kind(self, *kinds: str) -> list[GlmObject]:
        """Objects of some classes, in the order of the file."""
        return [item for item in self.file.objects if item.kind in kinds]

    def parent(self, item: GlmObject) -> GlmObject | None:
        """The object that an object belongs to, or None."""
        return self.reference(item, "parent") if "parent" in item.properties else item.parent

    def reference(self, item: GlmObject, name: str, *kinds: str) -> GlmObject:
        """The object that a property names; FeederError unless it exists and is of one of the classes."""
        target = self._by_name.get(self.word(item, name))
        if target is None:
            wrong(item, name, "is no object of the model; add it or correct the name")
        if kinds and target.kind not in kinds:
            wrong(item, name, f"is a {target.kind}; must be one of {', '.join(kinds)}")
        return target

    def word(self, item: GlmObject, name: str, default: str | None = None) -> str:
        """A property as text; FeederError if it is missing and has no default."""
        if name in item.properties:
            return item.properties[name].text
        if default is None:
            wrong(item, name, "is missing; add it")
        return default

    def value(self, item: GlmObject, name: str, quantity: str, default: complex | None = None) -> complex:
        """A complex property in GridLAB-D's unit; FeederError if it is missing without a default or no number."""
        if name not in item.properties:
            if default is None:
                wrong(item, name, "is missing; add it")
            return default
        try:
            return number(item.properties[name].text, quantity)
        except ValueError as error:
            wrong(item, name, str(error))

    def real(self, item: GlmObject, name: str, quantity: str, default: float | None = None) -> float:
        """A real property in GridLAB-D's unit."""
        value = self.value(item, name, quantity, default)
        if value.imag:
            wrong(item, name, "must be a real number")
        return value.real

    def positive(self, item: GlmObject, name: str, quantity: str, default: float | None = None) -> float:
        """A real property that must be positive."""
        value = self.real(item, name, quantity, default)
        if not value > 0.0:
            wrong(item, name, "must be positive")
        return value

    def keyword(self, item: GlmObject, kind: str, name: str, default: str | None = None) -> str:
        """Keyword of an enumeration, which a file may write as its number; ``kind`` is the class that defines it."""
        text = self.word(item, name, default)
        try:
            return keyword(text, ENUMERATIONS[kind][name])
        except ValueError as error:
            wrong(item, name, str(error))

    def phases(self, item: GlmObject, name: str = "phases", default: str | None = None) -> str:
        """Letters of a set of phases in the order A, B, C, N, D, S, G; a file may write their number."""
        text = self.word(item, name, default)
        try:
            return phase_letters(text)
        except ValueError as error:
            wrong(item, name, str(error))

    def setting(self, module: str, name: str, default: str) -> str:
        """A setting of a module as text."""
        entry = self.file.modules.get(module, {}).get(name)
        return entry.text if entry else default

    def frequency_hz(self) -> float:
        """System frequency of the module powerflow, Hz."""
        text = self.setting("powerflow", "nominal_frequency", "60")
        try:
            value = number(text, "frequency")
        except ValueError as error:
            raise FeederError(f"{self.file.path}: module powerflow: nominal_frequency {text!r} {error}") from None
        if value.imag or not value.real > 0.0:
            raise FeederError(f"{self.file.path}: module powerflow: nominal_frequency {text!r} must be positive")
        return value.real

    def bus_object(self, item: GlmObject) -> GlmObject:
        """The object whose bus a node, meter, load or capacitor is part of: its topmost parent among these."""
        visited = {id(item)}
        while (parent := self.parent(item)) is not None and parent.kind in NODES:
            if id(parent) in visited:
                wrong(item, "parent", "makes a circle")
            visited.add(id(parent))
            item = parent
        return item

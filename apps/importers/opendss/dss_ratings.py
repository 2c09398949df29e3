"""Ratings that an OpenDSS script gives, apart from the defaults that OpenDSS puts in their place.

OpenDSS gives every line a rating: 400 A where the script has none. To distinguish the two, the script is read a second
time, and an unlikely rating is set on every line, line code and wire when it is made. A rating that the script writes
(on the line, by a line code, a geometry, ``like`` or an edit) replaces it, and is then the same in both readings.
"""

from __future__ import annotations

import json
import math
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple

from dcgrid_env.apps.importers.import_report import Report
from dcgrid_env.apps.importers.opendss.dss_circuit import DssCircuit, new_engine, run_command, script_of
from dcgrid_env.apps.importers.opendss.dss_words import words_of
from dcgrid_env.grid.topology import FeederError

_CONDUCTORS = ("line", "linecode", "wiredata", "cndata", "tsdata", "reactor")
_UNLIKELY = {"normamps": 987654.25, "emergamps": 987655.25}
"""Ratings that no script gives, A."""


class Further(NamedTuple):
    """A rating next to the normal rating without a season: A of lines, kVA of transformers; NaN where not given."""

    season: str
    normal: float
    emergency: float


class ScriptRatings:
    """The ratings of a circuit's elements, NaN where its script gives none.

    Parameters
    ----------
    circuit
        The circuit as OpenDSS has it.
    master
        The script that it was read from.
    report
        Where it is noted what a rating was taken from.
    root
        Folder below which the script may read files.
    """

    def __init__(self, circuit: DssCircuit, master: Path, report: Report, root: Path | None = None) -> None:
        self._circuit, self._master, self._report, self._root = circuit, master, report, root

    def of_conductor(self, kind: str, name: str) -> float:
        """Normal ampacity of a line or series reactor, A; its emergency ampacity where that alone is written."""
        self._circuit.activate(kind, name)
        amps = {field: self._circuit.figure(field) for field in _UNLIKELY}
        if self._marked is None:
            if amps["normamps"] > 0.0:
                self._report.add("nothing lost", kind, name, "whether its rating is written cannot be told: it is kept")
            return amps["normamps"] if amps["normamps"] > 0.0 else math.nan
        self._marked.activate(kind, name)
        written = [amps[f] for f in _UNLIKELY if amps[f] > 0.0 and self._marked.figure(f) == amps[f]]
        if not written:
            return math.nan
        if written[0] != amps["normamps"]:
            self._report.add("nothing lost", kind, name, "rated by emergamps: the script gives no normamps")
        return written[0]

    def of_transformer(self, name: str) -> float:
        """Rating of a transformer's smaller winding, kVA: of normhkva where that is written, else of the kvas."""
        circuit = self._circuit
        circuit.activate("transformer", name)
        written, code = self._written(), circuit.text("xfmrcode")
        kvas, highest = circuit.figures("kvas"), circuit.figure("normhkva")
        if code:
            circuit.engine.Circuit.SetActiveClass("xfmrcode")
            circuit.engine.ActiveClass.Name(code)
            written |= self._written()
        if "normhkva" in written:
            return min(kvas) * highest / kvas[0]
        return min(kvas) if written & {"kva", "kvas"} else math.nan

    def conductor_ratings(self, name: str) -> list[Further]:
        """Emergency ampacity of a line where the script gives it next to normamps, and the ampacities of seasons, A."""
        self._circuit.activate("line", name)
        emergency = self._circuit.figure("emergamps")
        if self._marked is not None:
            self._marked.activate("line", name)
            written = {field: self._marked.figure(field) != mark for field, mark in _UNLIKELY.items()}
            if not all(written.values()):
                emergency = math.nan
        return self._with_seasons(emergency if emergency > 0.0 else math.nan, 1.0)

    def transformer_ratings(self, name: str) -> list[Further]:
        """Emergency rating of a transformer's smaller winding and its ratings of seasons, kVA, as the script gives."""
        circuit = self._circuit
        circuit.activate("transformer", name)
        kvas = circuit.figures("kvas")
        share = min(kvas) / kvas[0]
        emergency = circuit.figure("emerghkva") if "emerghkva" in self._written() else math.nan
        return self._with_seasons(emergency * share, share)

    def _with_seasons(self, emergency: float, share: float) -> list[Further]:
        """Further ratings of the active element; OpenDSS numbers its seasons."""
        ratings = [] if math.isnan(emergency) else [Further("", math.nan, emergency)]
        if int(self._circuit.figure("seasons")) > 1:
            normal = self._circuit.figures("ratings")
            ratings += [
                Further(f"season{k}", value * share, math.nan) for k, value in enumerate(normal, 1) if value > 0
            ]
        return ratings

    def _written(self) -> set[str]:
        """Properties of the active element that the script sets."""
        text = self._circuit.engine.Element.ToJSON(0)
        try:
            return {name.lower() for name in json.loads(text)}
        except json.JSONDecodeError:  # OpenDSS writes infinity so that nothing reads it
            name = self._circuit.engine.Element.Name()
            raise FeederError(f"{name}: a property is no finite number; give one") from None

    @cached_property
    def _marked(self) -> DssCircuit | None:
        """The circuit with unlikely ratings where none is written; None for a script that is only run on trust."""
        engine: Any = new_engine()
        marks = " ".join(f"{field}={value}" for field, value in _UNLIKELY.items())
        try:
            for line in script_of(engine, self._master, self._root).lines():
                first, *rest = words_of(line.command)
                if first.text != "new" or rest[0].text.partition(".")[0].lower() not in _CONDUCTORS:
                    run_command(engine, line.command, line.where)
                    continue
                for command in (f"new {rest[0]}", f"more {marks}", " ".join(["more", *map(str, rest[1:])])):
                    run_command(engine, command, line.where)
        except FeederError:
            return None
        return DssCircuit(engine)

"""Load shapes of an OpenDSS circuit as load profiles: what each load draws over time, as shares of its nominal power.

In the modes daily, yearly and duty a load follows the shape that it names for this mode, or else its daily shape. At
hour t a shape with an even interval has the value of point round(t / interval). Points are counted from 1, and the
first follows the last again, so the value at t = 0 is that of the last point. The profiles are evaluated by this rule
at each of their times. A load whose ``status`` is fixed follows no shape. A shape with ``useactual`` has kW and kvar,
and the load multiplier does not scale them. Without a ``qmult`` the reactive power is then that of the power factor,
or 0 for a load with kvar.
"""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from dcgrid_env.apps.importers.import_report import Report
from dcgrid_env.apps.importers.opendss.dss_circuit import DssCircuit
from dcgrid_env.core.files import write_text
from dcgrid_env.grid.topology import FeederError
from dcgrid_env.traces import ProfileTable, write_profiles

MODES = ("daily", "yearly", "duty")
LONGEST = 10_000_000
"""Largest number of values of a profile file."""


@dataclass(frozen=True)
class ImportedProfiles:
    """Profiles of a mode of OpenDSS by class, shares of the nominal power, and the class of each load.

    Attributes
    ----------
    mode
        daily, yearly or duty.
    step_s
        Time between two samples, s; the first is at midnight.
    names, values
        Columns, with ".q" for reactive power, and their samples, (sample, column).
    classes
        Name and class of each load that follows a profile.
    """

    mode: str
    step_s: float
    names: tuple[str, ...]
    values: tuple[tuple[float, ...], ...]
    classes: tuple[tuple[str, str], ...]

    @property
    def file(self) -> str:
        """Name of the file of the profiles."""
        return f"load_profiles_{self.mode}.csv"

    @property
    def classes_file(self) -> str:
        """Name of the file of the classes."""
        return f"load_classes_{self.mode}.csv"


@dataclass(frozen=True)
class _ShapedLoad:
    """A load and its shapes; ``fixed_q`` for one whose kvar the script writes."""

    rows: tuple[str, ...]
    kw: float
    kvar: float
    fixed_q: bool
    exempt: bool
    mult: float
    shapes: dict[str, str]


@dataclass
class LoadShapes:
    """Loads with shapes as they are read, from which :meth:`profiles` makes a table for each mode."""

    circuit: DssCircuit
    report: Report
    _loads: list[_ShapedLoad] = field(default_factory=list)

    def add(self, name: str, rows: Sequence[str]) -> None:
        """Note the shapes of the active load, and the names of its rows in the table of loads."""
        circuit = self.circuit
        shapes = {mode: text for mode in MODES if (text := circuit.text(mode).lower()) and text != "none"}
        if not shapes:
            return
        status = circuit.text("status").lower()
        if status == "fixed":
            self.report.add("nothing lost", "load", name, "its load shape has no effect, because its status is fixed")
            return
        written = {key.lower() for key in json.loads(circuit.engine.Element.ToJSON(0))}
        mult = float(circuit.engine.Solution.LoadMult())
        kw, kvar, exempt = circuit.figure("kw"), circuit.figure("kvar"), status == "exempt"
        self._loads.append(_ShapedLoad(tuple(rows), kw, kvar, "kvar" in written, exempt, mult, shapes))

    def profiles(self) -> tuple[ImportedProfiles, ...]:
        """Return the profiles of each mode for which some load names a shape."""
        by_mode = [self._of_mode(mode) for mode in MODES if any(mode in load.shapes for load in self._loads)]
        return tuple(profiles for profiles in by_mode if profiles is not None)

    def _of_mode(self, mode: str) -> ImportedProfiles | None:
        of_load = {i: load.shapes.get(mode) or load.shapes.get("daily") or "" for i, load in enumerate(self._loads)}
        shapes = {name: self._shape(name) for name in dict.fromkeys(of_load.values()) if name}
        usable = {name: shape for name, shape in shapes.items() if isinstance(shape, _Shape)}
        for i, name in of_load.items():
            reason = shapes.get(name) if name else None
            if isinstance(reason, str):
                text = f"its {mode} load shape {name} is left out: {reason}"
                self.report.add_all("nothing lost", "load", self._loads[i].rows, text)
        if not usable:
            return None
        step_h = min(1.0, *(shape.step_h for shape in usable.values()))
        n = math.ceil(max(shape.step_h * len(shape.p) for shape in usable.values()) / step_h - 1e-9)
        times_h = step_h * np.arange(n)
        columns: dict[str, np.ndarray] = {}
        classes: list[tuple[str, str]] = []
        for i, name in of_load.items():
            load, shape = self._loads[i], usable.get(name)
            if shape is None:
                continue
            p, q = _shares(load, shape, mode)
            if p is None or q is None:
                text = f"its {mode} load shape {name} is left out: it is in kW or kvar, and the load has none"
                self.report.add_all("nothing lost", "load", load.rows, text)
                continue
            kind = name if p is shape.p else f"{name}_{load.rows[0]}"
            if kind not in columns:
                if len(columns) * n > LONGEST:
                    raise FeederError(f"the {mode} load shapes have more than {LONGEST:,} values; leave shapes out")
                columns[kind] = shape.sampled(p, times_h)
                if q is not p:
                    columns[f"{kind}.q"] = shape.sampled(q, times_h)
            classes += [(row, kind) for row in load.rows]
        if not columns:
            return None
        profiles = ImportedProfiles(
            mode, 3600.0 * step_h, tuple(columns), tuple(map(tuple, np.column_stack(list(columns.values())).tolist())),
            tuple(classes),
        )  # fmt: skip
        self.report.add_all("taken", "loadshape", dict.fromkeys(k for _, k in classes), f"in {profiles.file}")
        return profiles

    def _shape(self, name: str) -> _Shape | str:
        """Return a shape, or the reason why it cannot be a profile."""
        shape = self.circuit.engine.LoadShape
        shape.Name(name)
        p, q, step_h = np.array(shape.PMult()), np.array(shape.QMult()), float(shape.HrInterval())
        if step_h <= 0.0:
            return "its points are at uneven times"
        if step_h * 3600.0 < 1.0 - 1e-9:
            return "its points are less than 1 s apart"
        if not len(p) or not np.isfinite(p).all() or not np.isfinite(q).all():
            return "it has no points, or one that is no finite number"
        has_q = len(q) == len(p) and (len(q) > 1 or q[0] != 0.0)
        return _Shape(step_h, p, q if has_q else None, bool(shape.UseActual()))


@dataclass(frozen=True)
class _Shape:
    step_h: float
    p: np.ndarray
    q: np.ndarray | None
    actual: bool

    def sampled(self, values: np.ndarray, times_h: np.ndarray) -> np.ndarray:
        """Return values at times by OpenDSS's rule."""
        return values[(np.rint(times_h / self.step_h).astype(np.int64) - 1) % len(values)]


def _shares(load: _ShapedLoad, shape: _Shape, mode: str) -> tuple[np.ndarray | None, np.ndarray | None]:
    """Return a shape's points as shares of a load's nominal active and reactive power; None where there are none."""
    p, q = shape.p, shape.q
    if shape.actual:
        mult = 1.0 if load.exempt else load.mult  # of the nominal power alone
        if not load.kw * mult or (q is not None and q.any() and not load.kvar):
            return None, None
        p = p / (load.kw * mult)
        if q is None:
            q = np.zeros_like(p) if load.fixed_q else p
        elif q.any():
            q = q / (load.kvar * mult)
        return p, q
    q = p if q is None else q
    if load.exempt and mode == "yearly" and load.mult != 1.0:  # OpenDSS applies the load multiplier in this mode alone
        scaled = load.mult * p
        return scaled, scaled if q is p else load.mult * q
    return p, q


def write_imported_profiles(profiles: Sequence[ImportedProfiles], folder: Path) -> None:
    """Write the profiles of an import and the classes of its loads into the feeder's folder."""
    for one in profiles:
        table = ProfileTable(0.0, one.step_s, one.names, np.array(one.values))
        about = (
            f"load shapes of OpenDSS's mode {one.mode}, shares of the nominal power; {one.classes_file} has the loads"
        )
        write_profiles(table, folder / one.file, [about])
        write_text(folder / one.classes_file, "".join(f"{a},{b}\n" for a, b in (("load", "class"), *one.classes)))


def imported_profiles(records: Sequence[dict[str, Any]]) -> tuple[ImportedProfiles, ...]:
    """Return profiles from their form in JSON."""
    return tuple(
        ImportedProfiles(
            str(one["mode"]),
            float(one["step_s"]),
            tuple(one["names"]),
            tuple(map(tuple, one["values"])),
            tuple(map(tuple, one["classes"])),
        )
        for one in records
    )

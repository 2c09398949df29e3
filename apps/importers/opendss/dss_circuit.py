"""Circuit in OpenDSS: defined, solved without controls, and read element by element.

OpenDSSDirect.py comes with the extra ``opendss`` and is imported here alone, when a circuit is made.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csc_matrix

from dcgrid_env.apps.importers.opendss.script_counts import Counts
from dcgrid_env.apps.importers.opendss.script_reader import Script
from dcgrid_env.core.suggestions import from_clone
from dcgrid_env.grid.topology import FeederError

Engine = Any
"""An engine of OpenDSSDirect.py, which is optional and has no types."""
_CONTROLS_STILL_ACT = 485
"""OpenDSS's error of a solution whose controls act in every iteration; the circuit is then as the last one left it."""
_CONTROLS_OFF = -1
"""OpenDSS's code of the control mode in which no control acts."""
_SNAPSHOT = 0
"""OpenDSS's code of the mode that solves the present."""
TOLERANCE = 1e-10
"""OpenDSS's tolerance of the solution that is compared with, p.u.; its default of 1e-4 is too coarse."""


class Terminal(NamedTuple):
    """One end of an element."""

    bus: str
    nodes: tuple[int, ...]
    """Node of each conductor: 1, 2, 3 for the phases a, b, c, and 0 for ground."""


class DssCircuit:
    """Circuit in a separate OpenDSS engine; make one with :func:`loaded_circuit`."""

    def __init__(
        self,
        engine: Engine,
        skipped: Sequence[tuple[str, str]] = (),
        files: Sequence[Path] = (),
        unsettled: Sequence[str] = (),
    ) -> None:
        self.engine = engine
        self.has_controls_off = engine.Solution.ControlMode() == _CONTROLS_OFF
        """Whether the script ends with ``ControlMode=off``; ``solve`` sets it in any case."""
        self.skipped = tuple(skipped)
        """Commands and options that were left out of the script, each with its file and line."""
        self.unsettled = tuple(unsettled)
        """Lines of the script with a solution whose controls did not come to rest."""
        self.files = tuple(files)
        """The files that the circuit was read from, the master file first."""

    @property
    def name(self) -> str:
        """Name of the circuit."""
        return self.engine.Circuit.Name()

    def names(self, kind: str) -> list[str]:
        """Names of the enabled elements of a class, without the class."""
        return [name for name, enabled in self._all(kind) if enabled]

    def disabled(self, kind: str) -> list[str]:
        """Names of the elements of a class that are not in the circuit."""
        return [name for name, enabled in self._all(kind) if not enabled]

    def _all(self, kind: str) -> Iterator[tuple[str, bool]]:
        for full in self.engine.Circuit.AllElementNames():
            element_kind, _, name = full.partition(".")
            if element_kind.lower() == kind:
                self.engine.Circuit.SetActiveElement(full)
                yield name, bool(self.engine.CktElement.Enabled())

    def kinds(self) -> list[str]:
        """Classes of the circuit's elements, in lower case."""
        return list(dict.fromkeys(full.partition(".")[0].lower() for full in self.engine.Circuit.AllElementNames()))

    def activate(self, kind: str, name: str) -> None:
        """Choose the element that is asked about from here on."""
        if self.engine.Circuit.SetActiveElement(f"{kind}.{name}") < 0:
            raise FeederError(f"OpenDSS has no {kind}.{name}")

    def text(self, field: str) -> str:
        """A property of the active element, as OpenDSS writes it."""
        return str(self.engine.Properties.Value(field)).strip()

    def figure(self, field: str) -> float:
        """A property that is one figure."""
        return self._number(field, self.text(field))

    def figures(self, field: str) -> list[float]:
        """A property that is several figures."""
        return [self._number(field, word) for word in self.text(field).strip("[]()").replace(",", " ").split()]

    def _number(self, field: str, text: str) -> float:
        try:
            return float(text)
        except ValueError:
            name = self.engine.CktElement.Name().lower()
            raise FeederError(f"{name}: {field} is {text!r}, no finite number; give one") from None

    def yes(self, field: str) -> bool:
        """Whether a property is yes or true."""
        return self.text(field).lower() in ("yes", "true")

    def terminals(self) -> list[Terminal]:
        """Both ends of the active element, or its one."""
        element = self.engine.CktElement
        size, order = element.NumConductors(), list(element.NodeOrder())
        return [
            Terminal(bus.partition(".")[0].lower(), tuple(order[k * size : (k + 1) * size]))
            for k, bus in enumerate(element.BusNames())
        ]

    def open_conductors(self) -> list[list[bool]]:
        """Which of its phases the active element has open, at each end."""
        element = self.engine.CktElement
        phases = range(1, element.NumPhases() + 1)
        return [[bool(element.IsOpen(k + 1, i)) for i in phases] for k in range(element.NumTerminals())]

    def admittance(self) -> NDArray[np.complex128]:
        """Primitive admittance matrix of the active element, siemens, over the conductors of all its ends."""
        flat = np.asarray(self.engine.CktElement.YPrim(), np.float64)
        y = flat[::2] + 1j * flat[1::2]
        size = round(len(y) ** 0.5)
        return y.reshape(size, size).T

    @contextmanager
    def closed(self) -> Iterator[None]:
        """Close the active element within the block, so that its matrices can be read."""
        element = self.engine.CktElement
        where = sorted(self._opened(element.Name()))
        for end, phase in where:
            element.Close(end, phase)
        if where:
            self.build_admittances()
        yield
        for end, phase in where:
            element.Open(end, phase)
        if where:
            self.build_admittances()

    def build_admittances(self) -> None:
        """Update the admittance matrices of all elements and of the system after a change; voltages stay."""
        whole_matrix, new_voltages = 2, 0
        self.engine.Solution.BuildYMatrix(whole_matrix, new_voltages)

    def solve(self) -> bool:
        """Solve the present circuit with controls off and return whether OpenDSS converged."""
        settings = f"controlmode=off loadmodel=powerflow tolerance={TOLERANCE:g} maxiterations=1000"
        try:
            self._set_snapshot()
            self.engine.Text.Command(f"set {settings}")
            self.engine.Solution.Solve()
        except self.engine.DSSException as error:
            raise FeederError(f"OpenDSS cannot solve the circuit: {_one_line(error)}") from None
        return bool(self.engine.Solution.Converged())

    def stray_sources(self) -> list[str]:
        """Current sources, as class.name, of the solved circuit that are alone at nodes without admittance.

        OpenDSS leaves at such a node what its memory holds, and may then find no solution anywhere.
        """
        diagonal = csc_matrix(self.engine.YMatrix.getYsparse()).diagonal()  # without the last nodes, if these have none
        joined = {name for name, y in zip(self.engine.Circuit.YNodeOrder(), diagonal, strict=False) if y}
        names = []
        for kind in ("isource", "vccs"):
            for name in self.names(kind):
                self.activate(kind, name)
                nodes = {f"{end.bus}.{node}".upper() for end in self.terminals() for node in end.nodes}
                if joined.isdisjoint(nodes):
                    names.append(f"{kind}.{name}")
        return names

    def _set_snapshot(self) -> None:
        """Choose the mode that solves the present; OpenDSS then puts switches into their normal states: undo that."""
        if self.engine.Solution.Mode() == _SNAPSHOT:
            return
        before = {full: self._opened(full) for full in self.engine.Circuit.AllElementNames()}
        self.engine.Text.Command("set mode=snapshot")
        element = self.engine.CktElement
        for full, opened in before.items():
            for end, phase in opened ^ self._opened(full):
                (element.Open if (end, phase) in opened else element.Close)(end, phase)

    def _opened(self, full: str) -> set[tuple[int, int]]:
        self.engine.Circuit.SetActiveElement(full)
        ends = enumerate(self.open_conductors(), start=1)
        return {(end, phase) for end, phases in ends for phase, is_open in enumerate(phases, start=1) if is_open}

    def base_kv_ln(self, bus: str) -> float:
        """Line-to-neutral base voltage of a bus, kV, and 0 where none is set."""
        self.engine.Circuit.SetActiveBus(bus)
        return float(self.engine.Bus.kVBase())

    def coordinates(self, bus: str) -> tuple[float, float]:
        """Coordinates of a bus, NaN where there are none."""
        self.engine.Circuit.SetActiveBus(bus)
        if not self.engine.Bus.Coorddefined():
            return float("nan"), float("nan")
        return float(self.engine.Bus.X()), float(self.engine.Bus.Y())

    def node_numbers(self) -> set[int]:
        """Numbers of all nodes, such as 1, 2 and 3 for the phases."""
        return {int(name.rpartition(".")[2]) for name in self.engine.Circuit.AllNodeNames()}

    def source_kva(self) -> complex:
        """Power that the voltage sources deliver, kW and kvar."""
        total = 0j
        for name in self.names("vsource"):
            self.activate("vsource", name)
            flat = [float(figure) for figure in self.engine.CktElement.Powers()]
            total -= complex(sum(flat[::2]), sum(flat[1::2]))
        return total

    @contextmanager
    def without(self, elements: Sequence[str]) -> Iterator[None]:
        """Disable elements, each as class.name, within the block."""
        for enabled in (False, True):
            for full in elements:
                self.engine.Circuit.SetActiveElement(full)
                self.engine.CktElement.Enabled(enabled)
            if not enabled:
                yield

    def raise_impedances(self, factors: Mapping[str, float]) -> None:
        """Multiply the series impedances of lines and reactors, as class.name, by factors; their charging stays."""
        lines, reactors = self.engine.Lines, self.engine.Reactors
        for full, factor in factors.items():
            kind, _, name = full.partition(".")
            if kind == "reactor":
                reactors.Name(name)
                r_ohm, x_ohm = float(reactors.R()), float(reactors.X())
                reactors.R(factor * r_ohm)
                reactors.X(factor * x_ohm)
                continue
            lines.Name(name)
            r, x = ([factor * float(one) for one in matrix()] for matrix in (lines.RMatrix, lines.XMatrix))
            lines.RMatrix(r)
            lines.XMatrix(x)

    def volts(self) -> dict[str, complex]:
        """Voltage of each node to ground, V, by its name such as ``"671.1"``."""
        flat = np.asarray(self.engine.Circuit.AllBusVolts(), np.float64)
        names = [name.lower() for name in self.engine.Circuit.AllNodeNames()]
        return dict(zip(names, (flat[::2] + 1j * flat[1::2]).tolist(), strict=True))


def loaded_circuit(master: Path, trust: bool, root: Path | None = None) -> DssCircuit:
    """Define the circuit of a script in a separate engine, checked line by line unless it is trusted.

    ``root`` is the folder below which a checked script may read files, the master file's by default.

    Raises
    ------
    FeederError
        Where OpenDSSDirect.py is missing, the file is, a command is refused, or OpenDSS refuses one.
    """
    engine, skipped, files, unsettled = new_engine(), [], [master], []
    if not master.is_file():
        raise FeederError(f"there is no file {master}; give an OpenDSS master file")
    if trust:
        if not run_command(engine, f'redirect "{master.resolve()}"', str(master)):
            raise FeederError(f"{master}: the controls act until OpenDSS stops at a Solve; leave this command out")
    else:
        script = script_of(engine, master, root)
        for line in script.lines():
            if not run_command(engine, line.command, line.where):
                unsettled.append(line.where)
        skipped, files = script.skipped, list(script.files)
    if engine.Basic.NumCircuits() != 1:
        raise FeederError(f"{master} defines {engine.Basic.NumCircuits()} circuits; give one with New Circuit.name")
    return DssCircuit(engine, skipped, files, unsettled)


def script_of(engine: Engine, master: Path, root: Path | None = None) -> Script:
    """The script of a master file, by the names that an engine knows."""
    executive = engine.Executive
    commands = [executive.Command(k + 1) for k in range(executive.NumCommands())]
    options = [executive.Option(k + 1) for k in range(executive.NumOptions())]
    ffi = engine.dss_ffi
    schema = ffi.string(engine.dss_lib.DSS_ExtractSchema(ffi.NULL, False)).decode()
    return Script(master, commands, options, engine.Basic.Classes(), Counts(schema), root)


def run_command(engine: Engine, command: str, where: str) -> bool:
    """Run one command and return whether controls came to rest in it.

    FeederError, naming its place in the script, if OpenDSS refuses it.
    """
    try:
        engine.Text.Command(command)
    except engine.DSSException as error:
        if error.args[0] == _CONTROLS_STILL_ACT:
            return False
        raise FeederError(f"{where}: OpenDSS refuses the command: {_one_line(error)}") from None
    return True


def _one_line(error: Exception) -> str:
    return " ".join(str(error).split())


def new_engine() -> Engine:
    """An OpenDSS engine that acts on nothing outside; FeederError where OpenDSSDirect.py is missing."""
    try:
        from opendssdirect import dss  # pyright: ignore[reportMissingImports]  (in the extra opendss only)
    except ImportError:
        raise FeederError(f"reading OpenDSS files needs OpenDSSDirect.py; {from_clone('opendss')}") from None
    engine = dss.NewContext()
    for forbidden in ("AllowChangeDir", "AllowEditor", "AllowForms", "AllowDOScmd"):
        getattr(engine.Basic, forbidden)(False)
    engine.Text.Command("clear")
    return engine

"""Read a three-phase grid from a GridLAB-D model through the equivalent OpenDSS circuit."""

from __future__ import annotations

import dataclasses
import tempfile
from collections.abc import Collection
from pathlib import Path

import numpy as np

from dcgrid_env.apps.importers.gridlabd.circuit_script import CircuitScript, line_to_line
from dcgrid_env.apps.importers.gridlabd.glm_buses import LINKS, Buses, Names
from dcgrid_env.apps.importers.gridlabd.glm_links import add_lines, add_regulators, add_switches
from dcgrid_env.apps.importers.gridlabd.glm_loads import add_capacitors, add_loads
from dcgrid_env.apps.importers.gridlabd.glm_model import NODES, Model
from dcgrid_env.apps.importers.gridlabd.glm_text import GlmFile
from dcgrid_env.apps.importers.gridlabd.glm_transformers import add_transformers
from dcgrid_env.apps.importers.import_report import Report
from dcgrid_env.apps.importers.opendss import Imported
from dcgrid_env.apps.importers.opendss.circuit_process import read_in_child
from dcgrid_env.apps.importers.opendss.reading import digests, read_circuit
from dcgrid_env.grid.topology import FeederError

_DATA = (
    "overhead_line_conductor", "underground_line_conductor", "triplex_line_conductor", "line_spacing",
    "line_configuration", "triplex_line_configuration", "transformer_configuration", "regulator_configuration",
)  # fmt: skip
_NO_LOSS = (
    "recorder", "multi_recorder", "group_recorder", "collector", "histogram", "violation_recorder", "voltdump",
    "currdump", "billdump", "impedance_dump", "jsondump", "powerflow_json_dump", "assert", "double_assert",
    "complex_assert", "enum_assert", "int_assert", "climate", "weather", "csv_reader", "fault_check", "power_metrics",
    "metrics", "metrics_collector", "metrics_collector_writer", "eventgen", "helics_msg", "fncs_msg", "restoration",
)  # fmt: skip
_SOURCE_OHM = 1e-7
"""Impedance of the source, which is ideal in GridLAB-D."""
_BALANCED = 1e-3
"""Largest deviation of the source's voltages from a balanced system, relative."""
_SMALLER = "import a part of the model, or remove what makes it grow"
_ALWAYS = ("schedule", "capcontrol", "regulator", "source", "fuse", "recloser", "sectionalizer", "isolated")


def read_gridlabd(file: str | Path, *, allow: Collection[str] = (), root: str | Path | None = None) -> Imported:
    """Read the network of a GridLAB-D model; needs OpenDSSDirect.py, of the extra ``opendss``.

    Parameters
    ----------
    file
        Model file (.glm).
    allow
        Kinds of elements, such as ``"house"`` or ``"fuse"``, that may be left out although something is lost.
    root
        Folder below which the file may include others; the file's by default.

    Returns
    -------
    Imported
        Tables, findings, and OpenDSS's voltages of the equivalent circuit with the taps of the file.

    Raises
    ------
    FeederError
        If a directive is refused, a value cannot be read, or an element cannot be represented, naming file and line.
        If elements are lost and not allowed. If OpenDSSDirect.py is missing. If the child process that reads the model
        needs more time or memory than ``circuit_process`` allows.

    Notes
    -----
    The two legs of a split-phase bus are the phases a and b. Its voltage of leg 2 has the opposite sign of GridLAB-D's
    ``voltage_2``.
    """
    return read_in_child(read_model, str(file), allow, {"root": None if root is None else str(root)}, _SMALLER)


def read_model(file: str | Path, *, allow: Collection[str] = (), root: str | Path | None = None) -> Imported:
    """Read a model in this process: see ``read_gridlabd``, which has a child do it."""
    path = Path(file)
    model = Model(GlmFile(path, None if root is None else Path(root)))
    report = Report("model")
    _report_objects(model, report)
    kinds = (*_ALWAYS, *(row.kind for row in report.findings if row.fate == "lost"))
    if unknown := [kind for kind in allow if kind.lower() not in kinds]:
        raise FeederError(f"allow: {unknown[0]!r} is no kind of loss; choose among {', '.join(dict.fromkeys(kinds))}")
    commands = circuit_commands(model, report, path)
    report.refuse_unless(path.name, allow)
    with tempfile.TemporaryDirectory() as folder:
        master = Path(folder) / f"{path.stem}.dss"
        master.write_text("\n".join(commands), encoding="utf-8")
        try:
            circuit = read_circuit(master, allow=["isolated"])
        except FeederError as error:
            said = str(error).replace(str(master.resolve()), "script").replace(str(master), "script")
            raise FeederError(f"{path}: the equivalent OpenDSS circuit cannot be read: {said}") from None
    for row in circuit.findings:
        report.add_all(row.fate, row.kind, row.names, row.text)
    report.refuse_unless(path.name, allow)
    network = dataclasses.replace(circuit.network, source_of_facts=f"GridLAB-D model {path.name}")
    files = digests(dict.fromkeys(model.file.files), root or path.parent)
    return dataclasses.replace(circuit, network=network, findings=report.findings, files=files)


def _report_objects(model: Model, report: Report) -> None:
    """Note everything in the model that is not part of its network."""
    for text, where in model.file.skipped:
        report.add("nothing lost", "directive", f"{text} ({where})", "it does not change the network: it is left out")
    for item in model.file.objects:
        if item.kind in (*NODES, *LINKS, *_DATA):
            continue
        if item.kind in _NO_LOSS or item.kind.endswith("_assert"):
            report.add("nothing lost", item.kind, item.name, "it records, checks or triggers alone: it is left out")
        elif "from" in item.properties and "to" in item.properties:
            report.add("refused", item.kind, item.name, "a link of this class cannot be represented")
        else:
            report.add("lost", item.kind.lower(), item.name, "what it draws, injects or controls is left out")


def circuit_commands(model: Model, report: Report, path: Path) -> list[str]:
    """The OpenDSS commands of the equivalent circuit."""
    names = Names(report)
    buses = Buses(model, names)
    script = CircuitScript(model, buses, names, report)
    frequency_hz = model.frequency_hz()
    charging = model.setting("powerflow", "line_capacitance", "false").lower() in ("true", "1")
    _add_source(script, names.unique("circuit", path.stem), frequency_hz)
    add_lines(script, frequency_hz, charging)
    add_switches(script)
    add_transformers(script)
    add_regulators(script)
    add_loads(script)
    add_capacitors(script)
    script.commands.append("MakeBusList")
    for bus, volts in buses.base_v.items():
        script.commands.append(f"SetkVBase Bus={bus} kVLN={volts / 1000.0!r}")
        item = buses.objects[bus]
        if {"longitude", "latitude"} <= set(item.properties):
            x, y = (model.real(item, name, "ratio") for name in ("longitude", "latitude"))
            script.commands.append(f"SetBusXY Bus={bus} X={x!r} Y={y!r}")
    return script.commands


def _add_source(script: CircuitScript, name: str, frequency_hz: float) -> None:
    """Add the source: the positive-sequence part of the swing bus's voltages."""
    model, buses = script.model, script.buses
    swing = buses.swing
    bus = buses.name(swing)
    base_v = buses.base_v[bus]
    turn = np.exp(2j * np.pi / 3.0)
    balanced = base_v * np.array([1.0, turn**2, turn])
    names = [f"voltage_{phase}" for phase in "ABC"]
    voltages = np.array(
        [model.value(swing, key, "voltage", complex(v)) for key, v in zip(names, balanced, strict=True)]
    )
    positive = complex(voltages @ np.array([1.0, turn, turn**2])) / 3.0
    if np.abs(voltages - positive * balanced / base_v).max() > _BALANCED * abs(positive):
        script.report.add(
            "lost", "source", swing.name, "its voltages are not balanced; their positive sequence is taken"
        )
    script.commands += ["Clear", f"Set DefaultBaseFrequency={frequency_hz!r}"]
    script.new(
        "Circuit", name, bus1=f"{bus}.1.2.3", basekv=line_to_line(base_v), pu=abs(positive) / base_v,
        angle=float(np.degrees(np.angle(positive))), r1=0.0, x1=_SOURCE_OHM, r0=0.0, x0=_SOURCE_OHM,
    )  # fmt: skip

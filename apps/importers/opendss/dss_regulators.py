"""Transformers with a RegControl as rows of the regulators' table.

A voltage regulator proper (wye, the same voltage on both sides, the tap on the side that it feeds) is one row. Any
other transformer whose fed-from side is tapped, such as a substation transformer with its tap changer, becomes a
transformer at the neutral tap and an ideal regulator behind it. A separate bus connects the two. With the impedance z
of the transformer, V_2 = t (V_1 / n) - t^2 z I_2, which is equivalent. If the transformer is a row of the
admittances, the matrix at its neutral tap takes that place. A tap on the side that is fed from is fixed.

A control that does not act (disabled, ``MaxTapChange=0``, a winding of one tap, or ``ControlMode=off``) leaves a fixed
tap. The row of a regulator proper then has a ``max_taps_per_move`` of 0. Any other transformer is taken as one without
a control.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from dcgrid_env.apps.importers.import_report import Report
from dcgrid_env.apps.importers.opendss.dss_admittances import admittance_joint, joint_of
from dcgrid_env.apps.importers.opendss.dss_circuit import DssCircuit
from dcgrid_env.apps.importers.opendss.dss_lines import rounded
from dcgrid_env.apps.importers.opendss.dss_transformers import Unit, Winding
from dcgrid_env.apps.importers.opendss.joints import Joint, Letters, Supply
from dcgrid_env.grid.three_phase_matrices import symmetric

_SAME = 1e-9  # relative
_WHOLE = 1e-6  # of a tap


@dataclass(frozen=True)
class Regulation:
    """A RegControl: which transformer's winding it taps, and the columns of its row that are the control's."""

    name: str
    unit: str
    winding: int
    """1 or 2, in OpenDSS's order."""
    sensed: int
    """Which of the transformer's phases it senses, from 0."""
    values: dict[str, Any]

    @property
    def is_fixed(self) -> bool:
        """Whether the control does not act, so its tap is fixed."""
        return not self.values["max_taps_per_move"]


def read_regulations(circuit: DssCircuit, report: Report, supply: Supply, letters: Letters) -> dict[str, Regulation]:
    """The control of each transformer that has one, by the transformer's name."""
    regulations: dict[str, Regulation] = {}
    disabled, transformers = circuit.disabled("regcontrol"), {name.lower() for name in circuit.names("transformer")}
    units_out = {name.lower() for name in circuit.disabled("transformer")}
    for name in [*circuit.names("regcontrol"), *disabled]:
        circuit.activate("regcontrol", name)
        unit = circuit.text("transformer").lower().removeprefix("transformer.")
        if unit in units_out or (name in disabled and (unit in regulations or unit not in transformers)):
            reason = (
                f"its transformer {unit} is disabled" if unit in units_out else "disabled: it is not in the circuit"
            )
            report.add("nothing lost", "regcontrol", name, reason)
            continue
        if unit in regulations:
            report.add("lost", "regcontrol", name, "a second control of one transformer is left out")
            continue
        why = "disabled" if name in disabled else _why_fixed(circuit, unit)
        if why:
            report.add("nothing lost", "regcontrol", name, f"{why}: its tap is fixed")
        circuit.activate("regcontrol", name)
        regulations[unit] = _regulation(circuit, Report() if why else report, supply, letters, name, unit)
        if why:
            regulations[unit].values["max_taps_per_move"] = 0
    return regulations


def _why_fixed(circuit: DssCircuit, unit: str) -> str:
    """Why the active control, which is enabled, moves no tap; empty if it acts."""
    if circuit.has_controls_off:
        return "ControlMode=off"
    if circuit.figure("maxtapchange") < 1.0:
        return "MaxTapChange=0"
    winding, taps = int(circuit.figure("tapwinding") or circuit.figure("winding")), circuit.engine.Transformers
    taps.Name(unit)
    taps.Wdg(winding)
    return "" if taps.NumTaps() and taps.MinTap() < taps.MaxTap() else f"{unit} has one tap"


def _regulation(
    circuit: DssCircuit, report: Report, supply: Supply, letters: Letters, name: str, unit: str
) -> Regulation:
    if circuit.yes("inversetime"):
        report.add("lost", "regcontrol", name, "its delay that falls with the deviation is constant here")
    if circuit.yes("cogen"):
        report.add("lost", "regcontrol", name, "its control of cogeneration is left out")
    reverses, threshold_kw = circuit.yes("reversible"), circuit.figure("revthreshold")
    if circuit.figure("vlimit") > 0:
        report.add("lost", "regcontrol", name, "its limit of voltage is left out")
    winding, sensed = int(circuit.figure("winding")), circuit.text("ptphase").lower()
    remote, remote_pt = circuit.text("bus").lower(), circuit.figure("remoteptratio")
    tapped = int(circuit.figure("tapwinding") or winding)
    if tapped != winding:
        report.add("lost", "regcontrol", name, "it senses the winding that it taps here, not the other")
    if not sensed.isdigit():
        report.add("lost", "regcontrol", name, f"it senses its first phase here, not the {sensed} of all")
    values = {
        "vreg_v": "vreg", "band_v": "band", "pt_ratio": "ptratio", "ct_primary_a": "ctprim", "r_ldc_v": "r",
        "x_ldc_v": "x", "delay_s": "delay", "tap_delay_s": "tapdelay",
    }  # fmt: skip
    row: dict[str, Any] = {column: circuit.figure(field) for column, field in values.items()}
    row["max_taps_per_move"] = int(circuit.figure("maxtapchange"))
    row["sensed_bus"], row["z_ldc_v"] = "", circuit.figure("ldc_z")
    circuit.activate("transformer", unit)
    if row["z_ldc_v"]:
        row |= {"r_ldc_v": 0.0, "x_ldc_v": 0.0}
    if reverses:
        end = np.asarray(circuit.engine.CktElement.Powers(), np.float64)[::2].reshape(len(circuit.terminals()), -1)
        forward = -float(end[winding - 1].sum()) >= -threshold_kw
        text = "its control of reversed power is left out"
        now = f"{text}: power flows forward now" if forward else text
        report.add("nothing lost" if forward else "lost", "regcontrol", name, now)
    number = max(int(sensed) - 1, 0) if sensed.isdigit() else 0
    bus, *nodes = remote.split(".")
    phase = letters.text([int(nodes[0] if nodes and nodes[0].isdigit() else 1)] if remote else [])
    if phase and phase <= "c" and phase in supply.phases.get(bus, ""):
        row |= {"pt_ratio": remote_pt, "r_ldc_v": 0.0, "x_ldc_v": 0.0, "z_ldc_v": 0.0}
        row |= {"sensed_bus": bus, "sensed_phase": phase}
    elif remote:
        report.add("lost", "regcontrol", name, f"it senses its own terminal here, as {remote} is no phase with supply")
    return Regulation(name, unit, tapped, number, row)


def is_regulator(unit: Unit) -> bool:
    """Whether an oriented transformer is a row of the regulators' table by itself, without a transformer before it."""
    first, second = unit.windings
    alike = first.connection == second.connection and first.connection != "delta"
    return alike and first.tap == 1.0 and math.isclose(first.kv_ll, second.kv_ll, rel_tol=_SAME)


def has_row(unit: Unit, tapped: Winding, regulation: Regulation) -> bool:
    """Whether an oriented transformer at a fixed tap is a regulator proper at a whole tap of its range."""
    to = unit.windings[1]
    if not is_regulator(unit) or tapped is not to or regulation.sensed >= len(unit.nodes):
        return False
    if not (to.n_tap and to.tap_min <= to.tap <= to.tap_max and to.tap_min < to.tap_max):
        return False
    return max(abs(value - round(value)) for value in _taps(to)) <= _WHOLE


def _taps(winding: Winding) -> tuple[float, float, float]:
    """The tap of a winding, and its lowest and highest one, in steps from the neutral one."""
    step = (winding.tap_max - winding.tap_min) / winding.n_tap
    return (winding.tap - 1.0) / step, (winding.tap_min - 1.0) / step, (winding.tap_max - 1.0) / step


def regulator_row(
    unit: Unit, regulation: Regulation, from_bus: str, report: Report, connection: str = "wye"
) -> dict[str, Any] | None:
    """Return a row from an oriented transformer; None, with the reason in the report, if its tap is between steps."""
    to = unit.windings[1]
    if to.connection == "between":
        connection = "delta"
    step = (to.tap_max - to.tap_min) / to.n_tap
    tap, lowest, highest = _taps(to)
    if abs(tap - round(tap)) > _WHOLE or max(abs(end - round(end)) for end in (lowest, highest)) > _WHOLE:
        report.add("refused", "transformer", unit.name, f"its tap {to.tap:g} is not 1 plus whole steps of {step:g}")
        return None
    proper, size = is_regulator(unit), 1 if to.connection == "between" else len(unit.phases)
    if regulation.sensed >= len(unit.nodes):
        report.add("refused", "regcontrol", regulation.name, "ptphase is beyond the phases of its transformer")
        return None
    if to.connection == "delta":
        report.add("lost", "regcontrol", regulation.name, "it senses a phase to ground here, not the delta's voltage")
    if not regulation.is_fixed:
        report.add("taken", "regcontrol", regulation.name, "in regulators.csv")
    if not proper:
        between = "its transformer is a row of its own, at its neutral tap, with a bus between them"
        report.add("nothing lost", "regcontrol", regulation.name, between)
    return {
        "connection": connection, "name": regulation.name, "bank": unit.bank or to.bus,
        "from_bus": from_bus, "to_bus": to.bus,
        "phases": unit.phases, "sensed_phase": "abc"[unit.nodes[regulation.sensed] - 1],
        "kv_ln": rounded(to.kv_ll / math.sqrt(3.0)), "kva_per_phase": rounded(unit.kva / size),
        "rating_kva_per_phase": rounded(unit.rating_kva / size),
        "r_percent": unit.r_percent if proper else 0.0, "x_percent": unit.x_percent if proper else 0.0,
        "tap": round(tap), "tap_neutral": 0, "tap_min": round(lowest), "tap_max": round(highest),
        "tap_step": rounded(step), "antifloat_ppm": unit.antifloat_ppm if proper else 0.0, **regulation.values,
        "members": (f"transformer.{unit.name}",),
    }  # fmt: skip


def regulated_admittance(
    circuit: DssCircuit, letters: Letters, name: str, regulation: Regulation, between: str
) -> tuple[Joint, Unit, str] | str:
    """A transformer of any windings at its neutral tap, with the winding of a regulator behind it; or what is wrong.

    The tapped winding ends at the bus ``between``. Returned are the row of the admittances, the regulator as a unit
    and its connection.
    """
    joint = admittance_joint(circuit, letters, "transformer", name)
    if not isinstance(joint, Joint):
        return joint or "it connects nothing"
    end, size = circuit.terminals()[regulation.winding - 1], circuit.engine.CktElement.NumPhases()
    phases, neutral = end.nodes[:size], end.nodes[size:]
    taps = circuit.engine.Transformers
    taps.Name(name)
    taps.Wdg(regulation.winding)
    if taps.IsDelta() or not set(phases) <= {1, 2, 3} or any(map(any, circuit.open_conductors())):
        return "its winding is a delta, of other conductors than phases, or open"
    tapped = {(end.bus, letters[node]) for node in end.nodes if node}
    if any((other.bus, letters[node]) in tapped for other in circuit.terminals() if other != end for node in other.nodes
           if node):  # fmt: skip
        return "another of its windings ends at the same node"
    kva, kv = circuit.figures("kvas")[0], float(taps.kV()) * (math.sqrt(3.0) if size == 1 else 1.0)
    tap = float(taps.Tap())
    to = Winding(end.bus, "wye_grounded", kv, tap, float(taps.MinTap()), float(taps.MaxTap()), int(taps.NumTaps()))
    y = symmetric(joint.values["g_s"], joint.values["b_s"])
    scale = np.array([tap if node in tapped else 1.0 for node in joint.nodes])
    y = y * np.outer(scale, scale)
    inner = {(end.bus, letters[node]) for node in neutral if node}
    kept = [k for k, node in enumerate(joint.nodes) if node not in inner]
    nodes = tuple((between, joint.nodes[k][1]) if joint.nodes[k] in tapped else joint.nodes[k] for k in kept)
    legs = [f"{letters[phase]}{letters[neutral[0]]}" for phase in sorted(phases)] if inner else []
    unit = Unit(
        name, letters.text(phases), phases, (Winding(between, "", kv, 1.0, 1.0, 1.0, 1), to), kva, math.nan,
        0.0, 0.0, False, 0.0, 0.0, 0.0, circuit.text("bank"),
    )  # fmt: skip
    return joint_of(name, "transformer", nodes, y[np.ix_(kept, kept)], math.nan), unit, " ".join(legs) or "wye"

"""CapControls as rows of the table of capacitor controls.

A control that does not act (disabled, or all with ``ControlMode=off``) leaves its capacitor in its state.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

from dcgrid_env.apps.importers.import_report import Report
from dcgrid_env.apps.importers.opendss.dss_circuit import DssCircuit
from dcgrid_env.apps.importers.opendss.joints import Joint, Letters, Supply

Row = dict[str, Any]
_MEASURES = {"current": "current", "voltage": "voltage", "kvar": "kvar", "powerfactor": "power_factor"}
_STATISTICS = {"avg": "mean", "max": "max", "min": "min"}


def fixed_capacitors(circuit: DssCircuit, report: Report) -> set[str]:
    """Names of the capacitors with controls none of which acts, in lower case."""
    disabled = circuit.disabled("capcontrol")
    acting: set[str] = set()
    idle: dict[str, str] = {}
    for name in [*circuit.names("capcontrol"), *disabled]:
        circuit.activate("capcontrol", name)
        bank = circuit.text("capacitor").lower().removeprefix("capacitor.")
        if name in disabled or circuit.has_controls_off:
            idle[name] = bank
        else:
            acting.add(bank)
    for name, bank in idle.items():
        why = "disabled" if name in disabled else "ControlMode=off"
        consequence = "it is not in the circuit" if bank in acting else "its capacitor stays in its state"
        report.add("nothing lost", "capcontrol", name, f"{why}: {consequence}")
    return set(idle.values()) - acting


def read_capacitor_controls(
    circuit: DssCircuit,
    report: Report,
    supply: Supply,
    letters: Letters,
    lines: Sequence[Joint],
    steps: Mapping[str, Sequence[Sequence[str]]],
) -> list[Row]:
    """Rows of the controls, one for each switched row of the capacitors' table.

    ``steps`` are the names of these rows by capacitor, those of one step together.
    """
    rows: list[Row] = []
    controlled: set[str] = set()
    for name in circuit.names("capcontrol") if not circuit.has_controls_off else ():
        circuit.activate("capcontrol", name)
        bank = circuit.text("capacitor").lower()
        if bank in controlled:
            report.add("lost", "capcontrol", name, "a second control of one capacitor is left out")
            continue
        columns = (
            _row(circuit, supply, letters, lines, name, bank) if bank in steps else "its capacitor is not switched"
        )
        if isinstance(columns, str):
            report.add("lost", "capcontrol", name, f"{columns}: its capacitor stays as it stands")
            continue
        controlled.add(bank)
        of_steps = steps[bank]
        if len(of_steps) > 1:  # OpenDSS keeps the time of the last opening for banks of one step alone
            columns["dead_time_s"] = 0.0
        for k, names in enumerate(of_steps):
            after = of_steps[k - 1][0] if k else ""
            suffixed = len(of_steps) > 1 or len(names) > 1
            rows += [
                {**columns, "name": f"{name}_{row}" if suffixed else name, "capacitor": row, "after": after}
                for row in names
            ]
        text = "in capacitor_controls.csv; it acts with grid_control.capacitors=controlled"
        report.add("taken", "capcontrol", name, text)
    return rows


def _row(
    circuit: DssCircuit, supply: Supply, letters: Letters, lines: Sequence[Joint], name: str, bank: str
) -> Row | str:
    """The columns of a control other than its name and bank, or what is wrong."""
    measures = _MEASURES.get(circuit.text("type").lower())
    if measures is None:
        return f"type={circuit.text('type')} is not among {', '.join(_MEASURES)}"
    fields = ("onsetting", "offsetting", "ptratio", "ctratio", "delay", "delayoff", "deadtime", "vmin", "vmax")
    on_at, off_at, pt_ratio, ct_ratio, delay_on_s, delay_off_s, dead_time_s, low_v, high_v = map(circuit.figure, fields)
    if measures == "power_factor":
        on_at, off_at = (2.0 + value if value < 0.0 else value for value in (on_at, off_at))
    if not (on_at < off_at if measures in ("voltage", "power_factor") else on_at > off_at):
        return f"OnSetting={on_at:g} and OffSetting={off_at:g} would switch it back and forth"
    overrides = circuit.yes("voltoverride") and measures != "voltage"
    pt, ct, other_bus = (circuit.text(field).lower() for field in ("ptphase", "ctphase", "vbus"))
    share, element, terminal = circuit.figure("pctminkvar"), circuit.text("element"), int(circuit.figure("terminal"))
    circuit.activate("capacitor", bank)
    delta = circuit.text("conn").lower() in ("delta", "ll")
    n_phase, kvar = circuit.engine.CktElement.NumPhases(), sum(circuit.figures("kvar"))
    circuit.activate(*element.split(".", 1))
    ends, size = circuit.terminals(), circuit.engine.CktElement.NumPhases()
    end = ends[terminal - 1]
    if len(ends) > 2 or (measures != "voltage" and len(ends) != 2):
        return f"it measures {measures} at {element}, which has {len(ends)} ends"
    phases = [letters[node] if node else "" for node in end.nodes[:size]]
    volts = phases
    bus = end.bus
    if overrides and other_bus:
        bus, volts = other_bus, list(supply.phases.get(other_bus, ""))[:n_phase]
    legs = _chosen(pt, volts, n_phase if delta else 0)
    through = _chosen(ct, phases) if measures == "current" else phases
    kept = (measures == "voltage" or overrides, measures != "voltage")
    for used, place, letters_there in zip(kept, (bus, end.bus), (legs, through), strict=True):
        if used and (
            not letters_there or not set("".join(letters_there)) <= set(supply.phases.get(place, "")) & set("abc")
        ):
            return f"its phases {' '.join(letters_there) or 'of no number'} at {place} are not among those with supply"
    far = ends[2 - terminal].bus if len(ends) == 2 else ""
    if measures != "voltage" and not _is_metered(supply, lines, end.bus, far, through):
        return f"it measures {measures} at {element}, at the end that feeds it, and that is no line"
    return {
        "measures": measures,
        "bus": bus if kept[0] else end.bus,
        "legs": " ".join(legs if kept[0] else through),
        "legs_of": _STATISTICS.get(pt, "mean"),
        "from_bus": end.bus if kept[1] else "",
        "to_bus": far if kept[1] else "",
        "phases": "".join(sorted(set("".join(through if kept[1] else legs)))),
        "phases_of": _STATISTICS.get(ct, "mean"),
        "on_at": on_at,
        "off_at": off_at,
        "pt_ratio": pt_ratio,
        "ct_ratio": ct_ratio,
        "delay_on_s": delay_on_s,
        "delay_off_s": delay_off_s,
        "dead_time_s": dead_time_s,
        "low_v": low_v if overrides else math.nan,
        "high_v": high_v if overrides else math.nan,
        "least_kvar": kvar * share / 100.0 if measures == "power_factor" else math.nan,
    }


def _chosen(which: str, phases: list[str], pairs: int = 0) -> list[str]:
    """The phases that PTPhase or CTPhase chooses, or for ``pairs`` phases of a delta a pair; none if there is none."""
    if which in _STATISTICS:
        return phases
    number = int(which) if which.isdigit() else 0
    if not 1 <= number <= len(phases):
        return []
    if not pairs:
        return [phases[number - 1]]
    following = number % pairs
    return [phases[number - 1] + phases[following]] if following < len(phases) else []


def _is_metered(supply: Supply, lines: Sequence[Joint], near: str, far: str, phases: list[str]) -> bool:
    """Whether the power flow has the current of some phases at one end of an element."""
    if supply.depth.get(near, 0) > supply.depth.get(far, math.inf):
        return True
    phases_there = {
        phase
        for line in lines
        if line.kind in ("phase_line", "switch") and line.closed and set(line.ends) == {near, far}
        for phase in line.phases
    }
    return near != far and set(phases) <= phases_there

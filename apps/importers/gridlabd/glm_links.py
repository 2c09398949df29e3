"""Lines, switches and regulators of a GridLAB-D model as OpenDSS elements."""

from __future__ import annotations

import numpy as np

from dcgrid_env.apps.importers.gridlabd.circuit_script import CircuitScript, line_to_line, matrices
from dcgrid_env.apps.importers.gridlabd.glm_buses import LINES, SWITCHES
from dcgrid_env.apps.importers.gridlabd.glm_model import wrong
from dcgrid_env.apps.importers.gridlabd.glm_text import GlmObject
from dcgrid_env.apps.importers.gridlabd.line_impedances import line_matrices

_SMALLEST_OHM = 1e-4
"""GridLAB-D's default resistance of a closed switch and of a regulator."""
_PROTECTION = {
    "fuse": "it never blows",
    "recloser": "it never opens",
    "sectionalizer": "it never opens",
}
_X_PERCENT = 1e-5
"""Reactance of a regulator, which has none in GridLAB-D, percent of OpenDSS's default base of 1000 kVA."""
_BASE_KVA = 1000.0
_RATINGS = ("rating.summer.continuous", "rating.winter.continuous")
_NEVER = 1e9
"""Rating, A, from which on a line has none."""


def add_lines(script: CircuitScript, frequency_hz: float, charging: bool) -> None:
    """Add the lines; ``charging`` is the setting line_capacitance of the module powerflow."""
    model, buses = script.model, script.buses
    for line in model.of_kind(*LINES):
        phases = "12" if line.kind == "triplex_line" else _phases(script, line)
        z, c = line_matrices(model, line, phases, frequency_hz, script.report)
        name, (first, second) = script.names.unique("line", line.name), buses.ends(line)
        rating_a = _rating_a(script, line, phases)
        script.new(
            "Line", name, bus1=buses.terminal(first, phases), bus2=buses.terminal(second, phases), phases=len(phases),
            units="mi", length=model.positive(line, "length", "length") / 5280.0,
            **matrices(z, c if charging else np.zeros_like(c)), **({"normamps": rating_a} if rating_a else {}),
        )  # fmt: skip
        if charging and not c.any() and line.kind != "triplex_line":
            text = "without charging: heights, diameters or the insulation are not in the model"
            script.report.add("nothing lost", line.kind, line.name, text)
        if model.keyword(line, "link", "status", "CLOSED") == "OPEN":
            script.commands.append(f"Open Line.{name} 1")


def _phases(script: CircuitScript, link: GlmObject) -> str:
    """Phases of a link between buses; ``"12"`` between two split-phase buses."""
    phases = script.model.phases(link)
    if "S" in phases:
        return "12"
    letters = "".join(phase for phase in phases if phase in "ABC")
    if not letters:
        wrong(link, "phases", "must have at least one of A, B and C")
    return letters


def _rating_a(script: CircuitScript, line: GlmObject, phases: str) -> float:
    """Smallest continuous rating of the phase conductors or the configuration, A; 0 where none is given."""
    model = script.model
    config = model.reference(line, "configuration")
    conductors = [f"conductor_{phase}" for phase in phases]
    holders = [model.reference(config, name) for name in conductors if name in config.properties] or [config]
    ratings = [model.real(one, name, "current") for one in holders for name in _RATINGS if name in one.properties]
    if "continuous_rating" in line.properties:
        ratings = [model.real(line, "continuous_rating", "current")]
    return min((rating for rating in ratings if 0.0 < rating < _NEVER), default=0.0)


def _phase_states(script: CircuitScript, switch: GlmObject, phases: str) -> list[bool]:
    """Whether each phase of a switch is closed.

    The phases of a bank follow the majority of their states; with as many open as closed, they follow its status.
    """
    model = script.model
    closed = model.keyword(switch, "link", "status", "CLOSED") == "CLOSED"
    if switch.kind == "fuse":
        good = [model.keyword(switch, "fuse", f"phase_{phase}_status", "GOOD") == "GOOD" for phase in phases]
        return [closed and state for state in good]
    states = [model.keyword(switch, "switch", f"phase_{phase}_state", "CLOSED") == "CLOSED" for phase in phases]
    if model.keyword(switch, "switch", "operating_mode", "BANKED") == "INDIVIDUAL":
        return [closed and state for state in states]
    whole = closed and 2 * sum(states) >= len(states)
    if closed and any(state != whole for state in states):
        text = f"{'closed' if whole else 'open'}, as the majority of the phases of its bank; write INDIVIDUAL otherwise"
        script.report.add("nothing lost", switch.kind, switch.name, text)
    return [whole] * len(states)


def _switch_ohm(script: CircuitScript, switch: GlmObject) -> complex:
    """Impedance of a closed switch, Ohm; parts that are not positive are GridLAB-D's default."""
    model = script.model
    if switch.kind == "fuse":
        z = complex(model.real(switch, "fuse_resistance", "impedance", 0.0))
    else:
        z = model.value(switch, "switch_impedance", "impedance", 0.0)
        z = complex(*(
            model.real(switch, f"switch_{part}", "impedance", default)
            for part, default in (("resistance", z.real), ("reactance", z.imag))
        ))  # fmt: skip
    return complex(z.real if z.real > 0.0 else _SMALLEST_OHM, max(z.imag, 0.0))


def add_switches(script: CircuitScript) -> None:
    """Add switches, fuses, reclosers and sectionalizers; phases that are open are separate open switches."""
    model, buses = script.model, script.buses
    for switch in model.of_kind(*SWITCHES):
        phases, (first, second) = _phases(script, switch), buses.ends(switch)
        if phases == "12":
            wrong(switch, "phases", "has S, which no switch of GridLAB-D has; give phases among A, B and C")
        z = _switch_ohm(script, switch)
        states = _phase_states(script, switch, phases)
        for closed in sorted(set(states), reverse=True):
            part = "".join(phase for phase, state in zip(phases, states, strict=True) if state == closed)
            name = script.names.unique("line", switch.name if len(part) == len(phases) else f"{switch.name}_{part}")
            script.new(
                "Line", name, bus1=buses.terminal(first, part), bus2=buses.terminal(second, part), phases=len(part),
                switch="yes", r1=z.real, x1=z.imag, r0=z.real, x0=z.imag, c1=0.0, c0=0.0, units="none", length=1.0,
            )  # fmt: skip
            if not closed:
                script.commands.append(f"Open Line.{name} 1")
        if switch.kind in _PROTECTION:
            script.report.add("lost", switch.kind, switch.name, _PROTECTION[switch.kind])


def add_regulators(script: CircuitScript) -> None:
    """Add the regulators: one for each phase, or one of three phases if its control level is BANK."""
    for regulator in script.model.of_kind("regulator"):
        _add_regulator(script, regulator)


def _add_regulator(script: CircuitScript, regulator: GlmObject) -> None:
    model, buses = script.model, script.buses
    config = model.reference(regulator, "configuration", "regulator_configuration")
    if model.keyword(config, "regulator_configuration", "connect_type", "WYE_WYE") != "WYE_WYE":
        wrong(config, "connect_type", "cannot be represented; only WYE_WYE can")
    phases, (first, second) = _phases(script, regulator), buses.ends(regulator)
    up, down = (int(model.positive(config, name, "ratio")) for name in ("raise_taps", "lower_taps"))
    for name, number in (("raise_taps", up), ("lower_taps", down)):
        if number < 1:
            wrong(config, name, "must be at least 1")
    step = model.real(config, "regulation", "plain number", 0.0) / up  # GridLAB-D reads 10 % as 10
    if step < 0.0 or (step == 0.0 and _control_kind(script, config) != "MANUAL"):
        wrong(config, "regulation", "must be positive, such as 0.1 for steps of 0.00625 by 16 taps")
    taps = {
        phase: model.real(
            regulator if f"tap_{phase}" in regulator.properties else config,
            f"tap_{phase}" if f"tap_{phase}" in regulator.properties else f"tap_pos_{phase}", "ratio", 0.0,
        )
        for phase in phases
    }  # fmt: skip
    control = _control(script, regulator, config, buses.base_v[second])
    by_current = model.keyword(config, "regulator_configuration", "Type", "B") == "B"
    banked = model.keyword(config, "regulator_configuration", "control_level", "INDIVIDUAL") == "BANK"
    if banked and (len(phases) < 3 or len(set(taps.values())) > 1):
        banked = False
        text = "its bank has fewer than three phases or unlike taps: each phase is controlled separately"
        script.report.add("lost", "regulator", regulator.name, text)
    if by_current and control.get("enabled") == "no":
        control = {}  # a fixed tap is exact as a transformer
    if by_current and control:
        text = "of type B: its voltage rises by 1 + tap x step here, not by 1 / (1 - tap x step)"
        script.report.add("lost", "regulator", regulator.name, text)
    r_ohm = model.real(regulator, "regulator_resistance", "impedance", _SMALLEST_OHM)
    for part in [phases] if banked else phases:
        name = script.names.unique("transformer", regulator.name if banked else f"{regulator.name}_{part}")
        volts = buses.base_v[first]
        kv = line_to_line(volts) if len(part) == 3 else volts / 1000.0
        tap = taps[part[0]]
        ratio = 1.0 / max(1.0 - tap * step, 1e-9) if by_current and not control else 1.0 + tap * step
        if not 0.1 <= ratio <= 10.0:
            wrong(config, "regulation", f"makes a ratio of {ratio:.3g} at tap {tap:g}; must be within 0.1 to 10")
        # The resistance is at the to side, and OpenDSS multiplies it by the square of the ratio there.
        r_percent = 100.0 * r_ohm / ratio**2 * _BASE_KVA / (1000.0 * kv**2)
        script.new(
            "Transformer", name, phases=len(part), windings=2, xhl=_X_PERCENT,
            buses=(buses.terminal(first, part), buses.terminal(second, part)), conns=("wye", "wye"), kvs=(kv, kv),
            ppm=0, **{"%rs": (r_percent / 2.0, r_percent / 2.0)}, wdg=2, maxtap=1.0 + up * step,
            mintap=1.0 - down * step, numtaps=up + down, tap=ratio,
        )  # fmt: skip
        if control:
            sensed_phases = model.phases(config, "PT_phase", phases)
            letter = next((phase for phase in phases if phase in sensed_phases), phases[0])
            controls = control | {"r": _ldc(script, config, "r", part[0]), "x": _ldc(script, config, "x", part[0])}
            sensed = {"ptphase": phases.index(letter) + 1} if banked else {}
            script.new("RegControl", name, transformer=name, winding=2, **controls, **sensed)


def _control_kind(script: CircuitScript, config: GlmObject) -> str:
    return script.model.keyword(config, "regulator_configuration", "Control", "MANUAL")


def _ldc(script: CircuitScript, config: GlmObject, letter: str, phase: str) -> float:
    if _control_kind(script, config) not in ("LINE_DROP_COMP", "MANUAL"):
        return 0.0
    return script.model.real(config, f"compensator_{letter}_setting_{phase}", "voltage", 0.0)


def _control(script: CircuitScript, regulator: GlmObject, config: GlmObject, volts: float) -> dict[str, object]:
    """Properties of the RegControls; empty for a regulator whose taps are set by hand and that has no band."""
    model, kind = script.model, _control_kind(script, config)
    center = model.real(config, "band_center", "voltage", 0.0)
    band = model.real(config, "band_width", "voltage", 0.0)
    if kind == "MANUAL" and not (center > 0.0 and band > 0.0):
        return {}
    if not (center > 0.0 and band > 0.0):
        wrong(config, "band_center" if band > 0.0 else "band_width", "must be positive")
    if kind == "REMOTE_NODE":
        script.report.add("lost", "regulator", regulator.name, "it senses its own terminal here, not its sense_node")
    ratio = model.real(config, "power_transducer_ratio", "ratio", 0.0)
    on_secondary = center < 0.5 * volts  # the voltage behind the potential transformer, such as 122 V
    if not ratio > 0.0:
        if on_secondary:
            wrong(config, "power_transducer_ratio", "is missing; band_center is behind a potential transformer")
        ratio = volts / 120.0
    scale = 1.0 if on_secondary else 1.0 / ratio
    current_ratio = model.real(config, "current_transducer_ratio", "ratio", 0.0)
    if not current_ratio > 0.0 and any(_ldc(script, config, part, phase) for part in "rx" for phase in "ABC"):
        wrong(config, "current_transducer_ratio", "must be positive; the compensator settings need it")
    return {
        "vreg": scale * center, "band": scale * band, "ptratio": ratio,
        "ctprim": current_ratio or 300.0,
        "delay": model.real(config, "time_delay", "time", 0.0),
        "tapdelay": max(model.real(config, "dwell_time", "time", 0.0), 0.0), "maxtapchange": 1,
        "enabled": "no" if kind == "MANUAL" else "yes",
    }  # fmt: skip

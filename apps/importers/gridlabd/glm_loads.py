"""Loads and capacitors of a GridLAB-D model as OpenDSS loads and capacitors."""

from __future__ import annotations

import cmath
import math
from collections.abc import Iterator

from dcgrid_env.apps.importers.gridlabd.circuit_script import CircuitScript
from dcgrid_env.apps.importers.gridlabd.glm_model import NODES, TRIPLEX, wrong
from dcgrid_env.apps.importers.gridlabd.glm_text import GlmObject

_ANGLES_DEG = {"A": 0.0, "B": -120.0, "C": 120.0, "AB": 30.0, "BC": -90.0, "CA": 150.0, "1": 0.0, "2": 0.0, "12": 0.0}
"""Angle of each leg's nominal voltage, which constant currents refer to."""
_NEXT = {"A": "AB", "B": "BC", "C": "CA"}
_LAWS = {"power": 1, "impedance": 2, "current": 5}
"""OpenDSS's model of each kind of load."""
_EXPONENTS = {"power": 0, "impedance": 2, "current": 1}
"""Exponent of the voltage in the power of each kind of load."""
_QUANTITIES = {"power": "power", "impedance": "impedance", "current": "current"}
_STEMS = ("power_", "current_", "impedance_", "shunt_", "constant_", "base_power")
_VOLTAGE_LIMITS = {"vminpu": 0.1, "vlowpu": 0.05, "vmaxpu": 2.0}
"""GridLAB-D's loads keep their law at any voltage."""


def add_loads(script: CircuitScript) -> None:
    """Add the loads of all nodes, meters and loads: one for each law, of three phases if they are alike."""
    for item in script.model.of_kind(*NODES):
        if item.kind == "capacitor":
            continue
        power_va: dict[tuple[str, str], complex] = {}
        for law, leg, va in _terms(script, item):
            power_va[law, leg] = power_va.get((law, leg), 0.0) + va
        for law in _LAWS:
            legs = {leg: va for (term_law, leg), va in power_va.items() if term_law == law and va}
            _add_legs(script, item, law, legs)


def _add_legs(script: CircuitScript, item: GlmObject, law: str, legs: dict[str, complex]) -> None:
    bus = script.buses.name(item)
    kv = script.buses.base_v[bus] / 1000.0
    whole = next((three for three in ("A B C", "AB BC CA") if set(three.split()) == set(legs)), None)
    if whole and len(set(legs.values())) == 1:
        legs = {whole: sum(legs.values())}
    for leg, va in legs.items():
        delta = len(leg) > 1 and not leg.startswith("A B")
        three = " " in leg
        name = item.name if three else f"{item.name}_{leg}"
        script.new(
            "Load", script.names.unique("load", f"{name}_{law}" if law != "power" else name),
            bus1=script.buses.terminal(bus, "ABC" if three else leg), phases=3 if three else 1,
            conn="delta" if three and delta else "wye", model=_LAWS[law],
            kv=kv * (2.0 if leg == "12" else math.sqrt(3.0) if three or delta else 1.0),
            kw=va.real / 1000.0, kvar=va.imag / 1000.0, **_VOLTAGE_LIMITS,
        )  # fmt: skip


def _terms(script: CircuitScript, item: GlmObject) -> Iterator[tuple[str, str, complex]]:
    """Each term of a load: its law, its leg, and its power at the base voltage of the bus, VA."""
    bus = script.buses.name(item)
    used: set[str] = set()
    triplex = item.kind in TRIPLEX
    delta = not triplex and "D" in script.model.phases(item)
    supply = next((phase for phase in script.model.phases(item) if triplex and phase in "ABC"), "A")
    # Currents of nodes and meters refer to the source's angle, those of loads to the leg's nominal voltage.
    turns_deg = {"": script.buses.shift_deg[bus] + _ANGLES_DEG[supply]}
    if "load" in item.kind:
        turns_deg["constant_"] = 0.0
    for name, leg in _properties(item, delta):
        fractions = list(_fractions(script, item, name, leg, used))
        volts, angle_deg = script.buses.base_v[bus] * _span(leg), _ANGLES_DEG[leg]
        for prefix, turn_deg in turns_deg.items():
            nominal = cmath.rect(volts, math.radians(angle_deg + turn_deg))
            for law, quantity in _QUANTITIES.items():
                value = _value(script, item, f"{prefix}{law}_{name}", quantity, used)
                if value and not (fractions and prefix):
                    yield law, leg, _power(law, value, nominal)
        yield from fractions
    for key, entry in item.properties.items():
        if key.startswith(_STEMS) and key not in used and _is_load(key) and entry.text.strip("0.+-jid ") != "":
            wrong(item, key, "cannot be read here; write constant_power, constant_current or constant_impedance")


def _span(leg: str) -> float:
    return 2.0 if leg == "12" else math.sqrt(3.0) if len(leg) == 2 else 1.0


def _properties(item: GlmObject, delta: bool) -> Iterator[tuple[str, str]]:
    """Suffix of the properties of each leg, and the leg."""
    if item.kind in TRIPLEX:
        yield from ((leg, leg) for leg in ("1", "2", "12"))
        return
    for phase in "ABC":
        yield phase, _NEXT[phase] if delta else phase
        yield f"{phase}N", phase
        yield _NEXT[phase], _NEXT[phase]


def _is_load(key: str) -> bool:
    return key.rpartition("_")[2] in ("A", "B", "C", "1", "2", "12", "AN", "BN", "CN", "AB", "BC", "CA", "real", "reac")


def _value(script: CircuitScript, item: GlmObject, key: str, quantity: str, used: set[str]) -> complex:
    """A complex property, or its parts ``_real`` and ``_reac``; zero where a schedule or player gives it."""
    total = 0.0 + 0.0j
    for name, unit in ((key, 1.0), (f"{key}_real", 1.0), (f"{key}_reac", 1.0j)):
        entry = item.properties.get(name)
        if entry is None:
            continue
        used.add(name)
        words = entry.text.replace("*", " ").split()
        if (
            words
            and not words[0][0].isdigit()
            and (words[0] in script.model.file.schedules or words[0].partition(".")[0] in script.model)
        ):
            script.report.add("lost", "schedule", item.name, f"{name} follows {words[0]}: it is zero here")
        else:
            total += unit * script.model.value(item, name, quantity)
    return total


def _power(law: str, value: complex, nominal: complex) -> complex:
    if law == "power":
        return value
    return nominal * value.conjugate() if law == "current" else abs(nominal) ** 2 / value.conjugate()


def _fractions(
    script: CircuitScript, item: GlmObject, name: str, leg: str, used: set[str]
) -> Iterator[tuple[str, str, complex]]:
    """Terms of a load that is written as a base power with fractions and power factors; they replace its constants.

    As in GridLAB-D, the other shares determine that of constant power, and a power factor of 0 means reactive power
    alone.
    """
    model = script.model
    used |= {f"{law}_{part}_{name}" for part in ("fraction", "pf") for law in _LAWS}
    total = _value(script, item, f"base_power_{name}", "power", used).real
    if not total:
        return
    bus = script.buses.name(item)
    growth = script.buses.base_v[bus] / script.buses.nominal_v(bus)
    shares = {law: model.real(item, f"{law}_fraction_{name}", "ratio", 0.0) for law in _LAWS}
    rest = 1.0 - shares["current"] - shares["impedance"]
    if not math.isclose(shares["power"], rest, abs_tol=1e-9):
        text = f"power_fraction_{name} is {rest:g}, as in GridLAB-D: the fractions of its base power do not add up to 1"
        script.report.add("nothing lost", item.kind, item.name, text)
        shares["power"] = rest
    for law, share in shares.items():
        factor = model.real(item, f"{law}_pf_{name}", "ratio", 1.0)
        if abs(factor) > 1.0:
            wrong(item, f"{law}_pf_{name}", "must be from -1 to 1")
        if share:
            reactive = math.sqrt(1.0 - factor**2) * (-1.0 if factor < 0.0 else 1.0)
            yield law, leg, total * share * growth ** _EXPONENTS[law] * complex(abs(factor), reactive)


def add_capacitors(script: CircuitScript) -> None:
    """Add the capacitors; one for each phase."""
    model = script.model
    for item in model.of_kind("capacitor"):
        text = model.phases(item, "phases_connected", model.word(item, "phases"))
        phases, delta = [phase for phase in "ABC" if phase in text], "D" in text
        bus = script.buses.name(item)
        rated = "cap_nominal_voltage" if "cap_nominal_voltage" in item.properties else "nominal_voltage"
        volts = model.positive(item, rated, "voltage", script.buses.base_v[bus])
        closed = _closed_phases(script, item)
        for phase in phases:
            kvar = model.value(item, f"capacitor_{phase}", "power", 0.0).real / 1000.0
            if kvar:
                leg = _NEXT[phase] if delta else phase
                script.new(
                    "Capacitor", script.names.unique("capacitor", f"{item.name}_{phase}"),
                    bus1=script.buses.terminal(bus, leg[:1]),
                    bus2=script.buses.terminal(bus, leg[1:]) if delta else f"{bus}.0",
                    phases=1, kv=volts / 1000.0, kvar=kvar, states=f"({int(phase in closed)})",
                )  # fmt: skip
        if model.keyword(item, "capacitor", "control", "MANUAL") != "MANUAL":
            script.report.add("lost", "capcontrol", item.name, "its capacitor stays as it is")


def _closed_phases(script: CircuitScript, item: GlmObject) -> str:
    """Phases of a capacitor whose switches are closed; those of a bank follow the phases of ``pt_phase``."""
    model = script.model
    closed = [p for p in "ABC" if model.keyword(item, "capacitor", f"switch{p}", "OPEN") == "CLOSED"]
    if model.keyword(item, "capacitor", "service_status", "IN_SERVICE") == "OUT_OF_SERVICE":
        script.report.add("nothing lost", "capacitor", item.name, "out of service: its switches are open")
        return ""
    if model.keyword(item, "capacitor", "control_level", "INDIVIDUAL") == "BANK":
        sensed = model.phases(item, "pt_phase") if "pt_phase" in item.properties else ""
        pairs = "D" in sensed
        senses = [phase for phase in closed if set(_NEXT[phase] if pairs else phase) <= set(sensed)]
        if bool(senses) != (len(closed) == len("ABC")):
            text = f"its bank is {'closed' if senses else 'open'}, as the switches of pt_phase"
            script.report.add("nothing lost", "capacitor", item.name, text)
        return "ABC" if senses else ""
    return "".join(closed)

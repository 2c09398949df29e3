"""Transformers of a GridLAB-D model as OpenDSS transformers.

GridLAB-D's impedance is in per unit of the secondary voltage as it is written, which may be line-to-line or
line-to-neutral, and of the whole rating. It is converted through ohms on the secondary side.
"""

from __future__ import annotations

import math

from dcgrid_env.apps.importers.gridlabd.circuit_script import CircuitScript, line_to_line
from dcgrid_env.apps.importers.gridlabd.glm_buses import connection, turns_ratio
from dcgrid_env.apps.importers.gridlabd.glm_model import Model, wrong
from dcgrid_env.apps.importers.gridlabd.glm_text import GlmObject

_LARGEST_SHUNT = 1e6
"""Shunt impedance, p.u., from which on there is none; GridLAB-D's default is 999999999."""
_REACTANCE_RATIO = 4.5
"""GridLAB-D's default ratio of reactance to resistance where a transformer is described by its losses."""


def add_transformers(script: CircuitScript) -> None:
    """Add the transformers."""
    for item in script.model.of_kind("transformer"):
        config = script.model.reference(item, "configuration", "transformer_configuration")
        kind = connection(script.model, item)
        phases = "".join(phase for phase in script.model.phases(item) if phase in "ABC")
        if not phases or (kind == "SINGLE_PHASE_CENTER_TAPPED" and len(phases) > 1):
            wrong(item, "phases", "must have one of A, B and C")
        if kind.startswith("DELTA") and len(phases) < 3:
            wrong(item, "phases", f"must have A, B and C for {kind}")
        if kind == "SINGLE_PHASE_CENTER_TAPPED":
            _add_centre_tapped(script, item, config, phases)
        else:
            _add_two_windings(script, item, config, phases, kind)


def _impedance(model: Model, config: GlmObject, number: str = "") -> complex:
    """A winding's impedance in per unit; zero where none is written."""
    z = model.value(config, f"impedance{number}", "ratio", 0.0)
    if z:
        return z
    return complex(*(model.real(config, f"{part}{number}", "ratio", 0.0) for part in ("resistance", "reactance")))


def _test_losses(model: Model, config: GlmObject) -> tuple[complex, complex] | None:
    """Series and shunt impedance of a centre-tapped transformer, per unit, from its losses where both are written."""
    no_load, full_load = (model.real(config, f"{name}_load_loss", "ratio", 0.0) for name in ("no", "full"))
    if not (no_load > 0.0 and full_load > 0.0):
        return None
    ratio = model.positive(config, "reactance_resistance_ratio", "ratio", _REACTANCE_RATIO)
    return complex(full_load, ratio * full_load), complex(1.0 / no_load, ratio / no_load)


def _core(model: Model, config: GlmObject, shunt: complex | None = None) -> dict[str, float]:
    """No-load losses and magnetising current of the shunt impedance, percent."""
    if shunt is None:
        shunt = model.value(config, "shunt_impedance", "ratio", 0.0)
        shunt = complex(
            model.real(config, "shunt_resistance", "ratio", shunt.real),
            model.real(config, "shunt_reactance", "ratio", shunt.imag),
        )
    parts = {"%noloadloss": shunt.real, "%imag": shunt.imag}
    return {name: 100.0 / value for name, value in parts.items() if 0.0 < value < _LARGEST_SHUNT}


def _kva(model: Model, config: GlmObject, phases: str) -> float:
    """Rating of all phases, kVA; the sum of the phases' ratings where no other is written."""
    if "power_rating" in config.properties:
        return model.positive(config, "power_rating", "rating")
    return sum(model.positive(config, f"power{phase}_rating", "rating") for phase in phases)


def _add_two_windings(script: CircuitScript, item: GlmObject, config: GlmObject, phases: str, kind: str) -> None:
    model, buses = script.model, script.buses
    first, second = buses.ends(item)
    kva, ratio = _kva(model, config, phases), turns_ratio(model, item)
    secondary = model.positive(config, "secondary_voltage", "voltage")
    z = _impedance(model, config)
    if not z.imag > 0.0:
        wrong(item, "configuration", "needs a positive reactance, or the imaginary part of impedance")
    z_ohm = z * secondary**2 / (1000.0 * kva)
    from_v = _line_to_neutral(model.positive(config, "primary_voltage", "voltage"), buses.base_v[first])
    units = [phases] if len(phases) == 3 else list(phases)
    conns = {"DELTA_DELTA": ("delta", "delta"), "DELTA_GWYE": ("delta", "wye")}.get(kind, ("wye", "wye"))
    for part in units:
        unit_kva = kva * len(part) / len(phases)
        kvs = [line_to_line(v) if len(part) == 3 else v / 1000.0 for v in (from_v, from_v / ratio)]
        percent = 100.0 * z_ohm * unit_kva / (1000.0 * kvs[1] ** 2)
        script.new(
            "Transformer", script.names.unique("transformer", item.name if len(units) == 1 else f"{item.name}_{part}"),
            phases=len(part), windings=2, buses=(buses.terminal(first, part), buses.terminal(second, part)),
            conns=conns, kvs=kvs, kvas=(unit_kva, unit_kva), xhl=percent.imag, ppm=1 if conns[1] == "delta" else 0,
            **{"%rs": (percent.real / 2.0, percent.real / 2.0)}, **_core(model, config),
        )  # fmt: skip


def _line_to_neutral(volts: float, base_v: float) -> float:
    """The line-to-neutral voltage of one that is written line-to-line or line-to-neutral, whichever is nearer."""
    return min((volts, volts / math.sqrt(3.0)), key=lambda v: abs(math.log(v / base_v)))


def _add_centre_tapped(script: CircuitScript, item: GlmObject, config: GlmObject, phase: str) -> None:
    """A transformer of three windings: half of the resistance and 0.8 of the reactance are in the primary.

    Each of the other two has the whole resistance and 0.4 of the reactance, unless ``impedance1`` or ``impedance2``
    are written: those are the other two, alike if one is missing, and ``impedance`` is the primary.
    """
    model, buses = script.model, script.buses
    first, second = buses.ends(item)
    kva = _phase_kva(script, item, config, phase)
    losses = _test_losses(model, config)
    z, shunt = losses or (_impedance(model, config), None)
    halves = [_impedance(model, config, number) for number in "12"]
    windings = [complex(0.5 * z.real, 0.8 * z.imag), *2 * [complex(z.real, 0.4 * z.imag)]]
    if any(halves):
        windings = [z, halves[0] or halves[1], halves[1] or halves[0]]
    if not z.imag > 0.0:
        wrong(item, "configuration", "needs a positive reactance, or the imaginary part of impedance")
    primary, secondary = (model.positive(config, f"{w}_voltage", "voltage") / 1000.0 for w in ("primary", "secondary"))
    x, x_1, x_2 = (100.0 * winding.imag for winding in windings)
    script.new(
        "Transformer", script.names.unique("transformer", item.name), phases=1, windings=3,
        buses=(buses.terminal(first, phase), f"{second}.1.0", f"{second}.0.2"), conns=("wye", "wye", "wye"),
        kvs=(primary, secondary, secondary), kvas=(kva, kva, kva), xhl=x + x_1, xht=x + x_2, xlt=x_1 + x_2, ppm=0,
        **{"%rs": [100.0 * winding.real for winding in windings]}, **_core(model, config, shunt),
    )  # fmt: skip


def _phase_kva(script: CircuitScript, item: GlmObject, config: GlmObject, phase: str) -> float:
    """Rating of the phase of a centre-tapped transformer, kVA; as in GridLAB-D, ``power_rating`` is that of three."""
    model = script.model
    if any(f"power{letter}_rating" in config.properties for letter in "ABC"):
        return model.positive(config, f"power{phase}_rating", "rating")
    kva = model.positive(config, "power_rating", "rating") / 3.0
    text = f"rated {kva:g} kVA, a third of power_rating, as in GridLAB-D; write power{phase}_rating otherwise"
    script.report.add("nothing lost", item.kind, item.name, text)
    return kva

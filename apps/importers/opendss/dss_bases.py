"""Frequency and base voltages of a circuit, before it is solved."""

from __future__ import annotations

import math
from collections import Counter

from dcgrid_env.apps.importers.opendss.dss_circuit import DssCircuit, run_command
from dcgrid_env.apps.importers.opendss.dss_words import quoted
from dcgrid_env.grid.topology import FeederError

_ALIKE = 0.05
"""Relative difference up to which two rated voltages have one base, that of the more windings: 13.2 and 13.8 kV."""
_LEAST_KV = 1e-3


def check_frequency(circuit: DssCircuit) -> None:
    """Raise FeederError for a source of another frequency than the solution's, which OpenDSS solves at 0 V."""
    frequency = float(circuit.engine.Solution.Frequency())
    for name in circuit.names("vsource"):
        circuit.activate("vsource", name)
        base_frequency = circuit.figure("basefreq")
        if not math.isclose(base_frequency, frequency):
            raise FeederError(
                f"source {name}: its basefreq is {base_frequency:g} Hz, but the circuit is solved at {frequency:g} Hz, "
                f"where OpenDSS has 0 V at every bus; put Set DefaultBaseFrequency={frequency:g} before New Circuit"
            )


def derive_bases(circuit: DssCircuit) -> tuple[int, list[float]]:
    """Give the buses that have no base voltage one; return their number and the line-to-line voltages to choose from.

    These are the script's ``VoltageBases``, or else the voltages of the source and of the transformers' windings.
    OpenDSS chooses from them by its voltages without load (``CalcVoltageBases``). Other buses keep their base voltages.
    """
    engine = circuit.engine
    run_command(engine, "makebuslist", "voltage bases")
    before = {bus: circuit.base_kv_ln(bus) for bus in engine.Circuit.AllBusNames()}
    lacking = [bus for bus, kv in before.items() if not kv > 0.0]
    if not lacking:
        return 0, []
    written = [float(kv) for kv in engine.Settings.VoltageBases()]
    fresh = engine.NewContext()
    fresh.Text.Command("clear")
    fresh.Text.Command("new circuit.c")
    bases = _rated_kv(circuit) if written == list(fresh.Settings.VoltageBases()) else written
    run_command(engine, f"set voltagebases=[{' '.join(map(repr, bases))}]", "voltage bases")
    run_command(engine, "calcvoltagebases", "voltage bases")
    for bus, kv in before.items():
        if kv > 0.0:
            run_command(engine, f"setkvbase bus={quoted(bus)} kvln={kv!r}", "voltage bases")
    return len(lacking), bases


def _rated_kv(circuit: DssCircuit) -> list[float]:
    """Rated line-to-line voltages of the sources and windings, of those that are nearly alike the most frequent."""
    rated_kv: list[float] = []
    for name in circuit.names("vsource"):
        circuit.activate("vsource", name)
        rated_kv.append(circuit.figure("basekv"))
    for name in circuit.names("transformer"):
        circuit.activate("transformer", name)
        size, ends = circuit.engine.CktElement.NumPhases(), circuit.terminals()
        circuit.engine.Transformers.Name(name)
        for k, end in enumerate(ends, start=1):
            circuit.engine.Transformers.Wdg(k)
            to_ground = size == 1 and not circuit.engine.Transformers.IsDelta() and not all(end.nodes[:2])
            rated_kv.append(float(circuit.engine.Transformers.kV()) * (math.sqrt(3.0) if to_ground else 1.0))
    number = Counter(round(kv, 4) for kv in rated_kv if kv > _LEAST_KV)
    kept: list[float] = []
    for kv, _ in number.most_common():
        if not any(math.isclose(kv, other, rel_tol=_ALIKE) for other in kept):
            kept.append(kv)
    return kept

"""Effects of the elements that an import omits: OpenDSS solves the circuit with and without them."""

from __future__ import annotations

import cmath
import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass

from dcgrid_env.apps.importers.import_report import Finding
from dcgrid_env.apps.importers.opendss.dss_circuit import DssCircuit, run_command

_STAY = ("load", "isolated")
"""Kinds whose elements stay in the circuit and lose a property or draw nothing."""
_LITTLE = 1e-9
"""Share of its power that an element keeps; without any, OpenDSS loses the power factor of a load."""
_SHARES = 7
"""Figures of ZIPV, of which the last is the voltage."""


@dataclass(frozen=True)
class LossEffect:
    """Change of OpenDSS's power flow, controls off, when lost elements are disabled.

    Attributes
    ----------
    kinds
        Kinds of the lost elements, as in the findings.
    number
        Number of elements.
    node
        Node whose voltage magnitude changes most, such as ``"671.a"``; empty if there is no solution.
    change_v, change_pu
        Change of its magnitude, V and p.u. of its base; NaN if there is no solution.
    change_kw, change_kvar
        Change of the power that the source delivers; NaN if there is no solution.
    """

    kinds: tuple[str, ...]
    number: int
    node: str
    change_v: float
    change_pu: float
    change_kw: float
    change_kvar: float


@dataclass(frozen=True)
class Solved:
    """A power flow of OpenDSS: voltages to ground in V by node, and the power of the source in kW and kvar."""

    volts: Mapping[str, complex]
    source_kva: complex


def solved(circuit: DssCircuit) -> Solved | None:
    """Solve the circuit with controls off; None if OpenDSS finds no solution, or one that is not finite."""
    converged, stray = circuit.solve(), circuit.stray_sources()
    if stray:
        with circuit.without(stray):
            return solved(circuit)
    solution = Solved(circuit.volts(), circuit.source_kva()) if converged else None
    return solution if solution and cmath.isfinite(solution.source_kva) else None


def loss_effects(
    circuit: DssCircuit, findings: Sequence[Finding], before: Solved, node_names: Mapping[str, tuple[str, float]]
) -> tuple[tuple[LossEffect, ...], Solved | None]:
    """Effects of each lost kind, and of all if there are several, with the power flow without all of them.

    Parameters
    ----------
    circuit
        The circuit, which is whole again afterwards.
    findings
        What became of each element.
    before
        Its power flow.
    node_names
        Name and base voltage to ground, V, of each node by OpenDSS's name.
    """
    lost: dict[str, list[str]] = {}
    for row in findings:
        if row.fate == "lost":
            lost.setdefault(row.kind, []).extend(row.names)
    groups = [(kind,) for kind in lost] + ([tuple(lost)] if len(lost) > 1 else [])
    effects, after = [], before
    for kinds in groups:
        number = sum(len(dict.fromkeys(lost[kind])) for kind in kinds)
        elements = [f"{kind}.{name}" for kind in kinds if kind not in _STAY for name in lost[kind]]
        with (
            circuit.without(elements),
            _without_cut_off(circuit, lost["load"] if "load" in kinds else ()),
            _without_draw(circuit, lost["isolated"] if "isolated" in kinds else ()),
        ):
            after = solved(circuit)
        effects.append(_effect(kinds, number, before, after, node_names))
    return tuple(effects), after


@contextmanager
def _without_cut_off(circuit: DssCircuit, loads: Iterable[str]) -> Iterator[None]:
    """Set the voltage below which loads are off (ZIPV) to 0 within the block."""
    before, engine = {}, circuit.engine.Loads
    for name in loads:
        engine.Name(name)
        shares = list(engine.ZipV())
        if len(shares) == _SHARES:
            before[name] = shares
            engine.ZipV([*shares[:-1], 0.0])
    yield
    for name, shares in before.items():
        engine.Name(name)
        engine.ZipV(shares)


@contextmanager
def _without_draw(circuit: DssCircuit, names: Iterable[str]) -> Iterator[None]:
    """Let isolated loads and capacitors draw nothing within the block; their nodes stay, and so do the others' numbers.

    They change something if only some of their conductors are isolated. Isolated lines and transformers do not.
    """
    loads, powers, steps = circuit.engine.Loads, {}, {}
    for word, _, name in (text.partition(" ") for text in names):
        if word == "load":
            loads.Name(name)
            powers[name] = loads.kW(), loads.kvar()
        elif word == "capacitor":
            circuit.activate(word, name)
            steps[name] = circuit.figures("kvar")
    for share in (_LITTLE, 1.0):
        for name, (kw, kvar) in powers.items():
            loads.Name(name)
            loads.kW(share * kw)
            loads.kvar(share * kvar)
        for name, kvars in steps.items():
            figures = " ".join(repr(share * kvar) for kvar in kvars)
            run_command(circuit.engine, f'edit "capacitor.{name}" kvar=[{figures}]', f"capacitor {name}")
        if share < 1.0:
            yield


def _effect(
    kinds: tuple[str, ...], number: int, before: Solved, after: Solved | None, names: Mapping[str, tuple[str, float]]
) -> LossEffect:
    nodes = [node for node in names if after and node in after.volts]
    change = {node: abs(after.volts[node]) - abs(before.volts[node]) for node in nodes} if after else {}
    if after is None or not all(map(math.isfinite, change.values())):
        return LossEffect(kinds, number, "", *[math.nan] * 4)
    most = max(change, key=lambda node: abs(change[node]))
    name, base_v = names[most]
    kva = after.source_kva - before.source_kva
    return LossEffect(kinds, number, name, change[most], change[most] / base_v, kva.real, kva.imag)

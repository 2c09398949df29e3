"""Emergency ratings and ratings of seasons of an OpenDSS script, as rows of the table ``rating``."""

from __future__ import annotations

import dataclasses

from dcgrid_env.apps.importers.import_report import Report
from dcgrid_env.apps.importers.opendss.dss_circuit import DssCircuit
from dcgrid_env.apps.importers.opendss.dss_ratings import ScriptRatings
from dcgrid_env.grid.network import Network, RatingTable


def with_further_ratings(network: Network, circuit: DssCircuit, ratings: ScriptRatings, report: Report) -> Network:
    """Add the ratings next to normamps and normhkva; report elements whose row has another form and none of them."""
    rows: list[tuple[str, str, float, float]] = []
    elements = {name: f"{kind} {name}" for kind in ("line", "switch") for name in _rated(network, kind)}
    for name in circuit.names("line"):
        further = ratings.conductor_ratings(name)
        if further and name not in elements:
            _report(report, "line", name)
        elif further:
            rows += [(elements[name], one.season, one.normal, one.emergency) for one in further]
    regulators: dict[str, dict[str, float]] = {}
    for name, rated in _rated(network, "regulator").items():
        circuit.activate("regcontrol", name)
        regulators.setdefault(circuit.text("transformer").lower(), {})[f"regulator {name}"] = rated
    transformers = _rated(network, "transformer")
    for name in circuit.names("transformer"):
        further, normal = ratings.transformer_ratings(name), ratings.of_transformer(name)
        rated = dict(regulators.get(name.lower(), {}))
        if name in transformers:
            rated[f"transformer {name}"] = transformers[name]
        if further and not (rated and normal > 0.0):
            _report(report, "transformer", name)
            continue
        for element, of_row in rated.items():
            share = of_row / normal  # of the phases of a regulator, and of taps in the rated voltages
            rows += [(element, one.season, one.normal * share, one.emergency * share) for one in further]
    return dataclasses.replace(network, rating=RatingTable(*zip(*rows, strict=True))) if rows else network


def _rated(network: Network, kind: str) -> dict[str, float]:
    """Rating of each row of a table, by name."""
    table, column, instead = {
        "line": (network.phase_line, "rating_a", ""),
        "switch": (network.switch, "rating_a", ""),
        "transformer": (network.transformer, "rating_kva", "kva"),
        "regulator": (network.regulator, "rating_kva_per_phase", "kva_per_phase"),
    }[kind]
    values = getattr(table, column) or getattr(table, instead, ()) or (0.0,) * len(table)
    return dict(zip(table.name, values, strict=True))


def _report(report: Report, kind: str, name: str) -> None:
    report.add("nothing lost", kind, name, "its emergency and seasonal ratings are not kept: its row has another form")

"""The published solutions of the three-phase feeders: OpenDSS's voltages, flows and losses at nine points each."""

from __future__ import annotations

import csv
import tomllib
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from dcgrid_env import ThreePhaseFeeder, load_feeder
from helpers.places import SHARED_THREE_PHASE, require

POINTS = ("nominal", "mult-0.5", "mult-0.8", "mult-1.1", "datacentre", "inverters", "regulated", "neutral-taps", "all")


@dataclass
class Point:
    """One operating point: its inputs, and OpenDSS's voltages by node, totals, and branch flows where published."""

    feeder: ThreePhaseFeeder
    p_kw: np.ndarray
    q_kvar: np.ndarray
    tap: np.ndarray
    v_pu: np.ndarray
    angle_deg: np.ndarray
    totals: dict
    flows: list[dict]


def node_of(feeder: ThreePhaseFeeder, bus: str, phase: str) -> int:
    return feeder.nodes_of(bus)[feeder.bus_phases[feeder.index(bus)].index(phase)]


def rows(path: Path) -> list[dict]:
    with path.open() as file:
        return list(csv.DictReader(file))


def published_point(name: str, point: str) -> Point:
    """Read a point; skips the test that calls this where the published folder is absent."""
    folder = require(SHARED_THREE_PHASE) / name
    feeder = load_feeder(name)
    head = tomllib.loads((folder / "feeder.toml").read_text())["golden"]
    totals, scale, tap = head, 1.0, feeder.base_tap
    voltages, flows = rows(folder / "golden.csv"), rows(folder / "golden-branches.csv")
    if point != "nominal":
        variants = tomllib.loads((folder / "golden-variants.toml").read_text())["variant"]
        totals = next(v for v in variants if v["name"] == point)
        scale, flows = totals["load_multiplier"], []
        tap = np.array([float(totals["taps"][one]) for one in feeder.network.regulator.name])
        voltages = [row for row in rows(folder / "golden-variants.csv") if row["variant"] == point]
    p_kw, q_kvar = scale * feeder.p_load_kw, scale * feeder.q_load_kvar
    for row in rows(folder / "golden-variants-devices.csv"):
        for k, phase in enumerate("abc") if row["variant"] == point else ():
            kw, kvar = float(row[f"kw_{k + 1}"]), float(row[f"kvar_{k + 1}"])
            if kw or kvar:
                leg = feeder.first_device_leg + node_of(feeder, row["bus"], phase)
                p_kw[leg] += kw
                q_kvar[leg] += kvar
    v_pu, angle_deg = np.full((2, feeder.n_node), np.nan)
    for row in voltages:
        node = node_of(feeder, row["bus"], row["phase"])
        v_pu[node], angle_deg[node] = float(row["v_pu"]), float(row["angle_deg"])
    assert np.isfinite(v_pu).all()
    return Point(feeder, p_kw, q_kvar, tap, v_pu, angle_deg, totals, flows)

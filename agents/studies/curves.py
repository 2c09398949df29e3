"""Learning curves out of training folders: the runs of one algorithm on one scenario are one line with its band."""

from __future__ import annotations

import csv
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from dcgrid_env.agents import Card

X = {"seconds": "seconds", "steps": "env_steps"}
"""What a curve may run along, with its column in curve.csv: training time, or steps of environments."""
POINTS = 200
"""Points of a line."""


@dataclass(frozen=True)
class Curve:
    """A run's validations."""

    scenario: str
    label: str
    """Algorithm, and the view where it is not the shared one."""
    seed: int
    x: np.ndarray
    """Training time, s, or steps of environments, (n,), rising."""
    gain_pct: np.ndarray
    """How far J lies below the tuned droop's, %, (n,)."""


@dataclass(frozen=True)
class Line:
    """The runs of one label together."""

    label: str
    x: np.ndarray
    """Training time, s, or steps of environments, (n,)."""
    mean_pct: np.ndarray
    """(n,), as the next two."""
    low_pct: np.ndarray
    high_pct: np.ndarray
    n_runs: int


def read(folder: Path, x: str = "seconds") -> Curve:
    """A training folder's curve along one of ``X``; ValueError, naming file and fault, where it has none."""
    path = folder / "curve.csv"
    if not path.is_file():
        raise ValueError(f"{folder}: there is no curve.csv; give the folder of a training run (dcgrid train)")
    with path.open(newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    along, j, j_droop = (_column(path, rows, name) for name in (X[x], "J", "J_droop"))
    measured = np.isfinite(j) & np.isfinite(j_droop) & np.isfinite(along)
    if not measured.any():
        raise ValueError(f"{path}: holds no validation yet; train on")
    card, view = Card.load(folder / "policy.json"), _policy_kind(folder / "config.json")
    label = card.algorithm if view in ("", "shared") else f"{card.algorithm}, {view}"
    gain_pct = 100.0 * (1.0 - j[measured] / j_droop[measured])
    return Curve(card.scenario, label, card.seed or 0, along[measured], gain_pct)


def _column(path: Path, rows: Sequence[Mapping[str, str | None]], name: str) -> np.ndarray:
    try:
        return np.array([float(row[name] or "nan") for row in rows])
    except (KeyError, ValueError) as error:
        raise ValueError(
            f"{path}: column {name} is missing or holds no figures ({error}); give a run that records it"
        ) from None


def _policy_kind(path: Path) -> str:
    try:
        return str(json.loads(path.read_text(encoding="utf-8")).get("view", ""))
    except (OSError, ValueError, AttributeError):
        raise ValueError(f"{path}: is no configuration of a training run; train again") from None


def lines(curves: Sequence[Curve]) -> dict[str, list[Line]]:
    """By scenario a line for each label, in the order in which they are given; ValueError for a seed given twice."""
    groups: dict[tuple[str, str], list[Curve]] = {}
    for curve in curves:
        groups.setdefault((curve.scenario, curve.label), []).append(curve)
    by_scenario: dict[str, list[Line]] = {}
    for (scenario, label), runs in groups.items():
        seeds = [run.seed for run in runs]
        twice = next((seed for seed in seeds if seeds.count(seed) > 1), None)
        if twice is not None:
            raise ValueError(f"folders: seed {twice} of {label} on {scenario} is there twice; give each run once")
        by_scenario.setdefault(scenario, []).append(_line(label, runs))
    return by_scenario


def _line(label: str, runs: Sequence[Curve]) -> Line:
    """Mean, lowest and highest from where all runs have been judged until the first of them ends.

    Between validations a run is as good as at the last.
    """
    begin, end = max(run.x[0] for run in runs), min(run.x[-1] for run in runs)
    x = runs[0].x if len(runs) == 1 else np.geomspace(max(begin, 1e-3), max(begin, end), POINTS)
    at = [run.gain_pct[np.searchsorted(run.x, x, side="right").clip(1) - 1] for run in runs]
    every = np.array(at)
    return Line(label, x, every.mean(axis=0), every.min(axis=0), every.max(axis=0), len(runs))

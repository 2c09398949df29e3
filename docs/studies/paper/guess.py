"""Settings that the paper does not state: a guess at them, and how close it comes to Table I."""

from __future__ import annotations

import dataclasses
from typing import Any, NamedTuple

import numpy as np

from dcgrid_env import Scenario, load_feeder
from dcgrid_env.apps.reproduction.paper import COUNTS, K_P_MW_PER_PU, TABLE_ONE
from dcgrid_env.apps.reproduction.study_runs import HEAD_PU, INVERTERS, Law, Run, Runs
from dcgrid_env.baselines.laws.droop import Memory

Records = dict[str, Any]


class Guess(NamedTuple):
    """The free settings; the defaults are those of the study."""

    squared: bool = False
    """Whether Table I reports abs(V^2 - 1) in place of abs(V - 1)."""
    v0_pu: float = HEAD_PU
    """Voltage of the substation."""
    capacitors: bool = True
    site_kw: float = 280.0
    """Rating of a data centre."""
    impedance_times: float = 1.0
    """Factor on the impedances of the feeder."""
    q_max_share: float = 0.33
    """Reactive limit of a data centre as a share of its rating."""
    inverter_kva: float = 50.0
    """Rating of an inverter."""
    k_q_mvar_per_pu_s: float = 0.5
    k_p_scale: float = 1.0
    """MW/p.u. for a k_p of 1."""
    alpha_per_s: float = 0.3
    memory: Memory = "cumulative"


LABELS = {
    "squared": "voltage in Table I",
    "v0_pu": "substation (p.u.)",
    "capacitors": "capacitors",
    "site_kw": "rating of a site (kW)",
    "impedance_times": "factor on impedances",
    "q_max_share": "reactive limit of a site (share of its rating)",
    "inverter_kva": "rating of an inverter (kVA)",
    "k_q_mvar_per_pu_s": "k_q (Mvar/(p.u. s))",
    "k_p_scale": "k_p = 1 equals (MW/p.u.)",
    "alpha_per_s": "alpha (1/s)",
    "memory": "backlog",
}
"""The free settings by name."""
VALUES: dict[str, tuple[Any, ...]] = {
    "squared": (False, True),
    "v0_pu": (1.0, 1.02, 1.03, 1.04, HEAD_PU, 1.047, 1.049, 1.05),
    "capacitors": (True, False),
    "impedance_times": (0.5, 1.0, 1.5, 2.0, 3.0),
    "q_max_share": (0.0, 0.05, 0.1, 0.2, 0.33),
    "inverter_kva": (25.0, 50.0, 100.0, 200.0, 300.0),
    "k_q_mvar_per_pu_s": (0.05, 0.1, 0.2, 0.5, 1.0),
    "k_p_scale": (0.2, 0.4, 0.6, 0.8, 1.0, 1.5, 2.0),
    "alpha_per_s": (0.003, 0.01, 0.03, 0.1, 0.3, 1.0),
    "memory": ("cumulative", "one_step"),
}
"""What the search tries for each."""
FOUND = Guess(
    v0_pu=1.05,
    capacitors=False,
    q_max_share=0.1,
    inverter_kva=300.0,
    k_q_mvar_per_pu_s=0.05,
    k_p_scale=0.2,
    alpha_per_s=0.003,
    memory="one_step",
)
"""The best of the search."""
LARGER = Guess(
    squared=True,
    v0_pu=1.049,
    site_kw=560.0,
    q_max_share=0.1,
    inverter_kva=100.0,
    k_q_mvar_per_pu_s=0.2,
    k_p_scale=0.6,
    alpha_per_s=0.01,
)
"""A guess with sites of twice the rating that the paper gives."""
COLUMNS = {"default": Guess(), "found": FOUND, "sites of 560 kW": LARGER}


def scenario_of(runs: Runs, guess: Guess, n: int) -> Scenario:
    """The study's scenario with ``n`` data centres under a guess."""
    feeder = load_feeder("ieee123")
    if guess.impedance_times != 1.0:
        feeder = dataclasses.replace(
            feeder, r_ohm=guess.impedance_times * feeder.r_ohm, x_ohm=guess.impedance_times * feeder.x_ohm
        )
    return runs.setting.scenario(
        n,
        feeder=feeder,
        source_voltage_pu=guess.v0_pu,
        background={"capacitors": guess.capacitors},
        datacenters={"p_rated_kw": guess.site_kw, "q_max_share": guess.q_max_share},
        inverters={"s_rated_kva": guess.inverter_kva},
    )


def law_of(guess: Guess, k_p: float) -> Law:
    """The law at a k_p of Table I under a guess."""
    return Law(
        k_p_mw_per_pu=guess.k_p_scale * k_p,
        k_q_mvar_per_pu_s=guess.k_q_mvar_per_pu_s,
        alpha_per_s=guess.alpha_per_s,
        memory=guess.memory,
    )


def cells(runs: Runs, guess: Guess) -> list[Records]:
    """Table I under a guess."""
    return [
        {"n_datacenters": n, "k_p": k_p} | figures(runs.run(scenario_of(runs, guess, n), law_of(guess, k_p)), guess)
        for n in COUNTS
        for k_p in K_P_MW_PER_PU
    ]


def figures(run: Run, guess: Guess) -> dict[str, float]:
    """The figures of a cell, of the voltage that the guess takes; a deviation of 1 if a power flow has no solution."""
    mean, std, outside = (
        ("squared_deviation_mean_pu", "squared_deviation_std_pu", "squared_outside_buses_pct")
        if guess.squared
        else ("voltage_deviation_mean_pu", "voltage_deviation_std_pu", "outside_buses_pct")
    )
    return {
        "deviation_pu": run.mean(mean) if run.mean("power_flow_converged") == 1.0 else 1.0,
        "std_pu": run.mean(std),
        "delay_s": run.mean("delay_mean_s"),
        "buses_inside_pct": 100.0 - run.mean(outside),
    }


class Distance(NamedTuple):
    """Distance of Table I under a guess from the paper's: mean absolute errors over the 15 cells."""

    deviation_pu: float
    delay_s: float
    total: float
    """Sum of both, each as a share of the mean of the paper's figures."""


def distance(rows: list[Records]) -> Distance:
    """Compute the distance of the cells of a guess from Table I."""
    paper = [TABLE_ONE[row["n_datacenters"], row["k_p"]] for row in rows]
    errors, means = {}, {}
    for key in ("deviation_pu", "delay_s"):
        published = np.array([getattr(cell, key) for cell in paper])
        errors[key] = float(np.abs(np.array([row[key] for row in rows]) - published).mean())
        means[key] = float(published.mean())
    return Distance(**errors, total=sum(errors[key] / means[key] for key in errors))


def guesses(runs: Runs) -> dict[str, Any]:
    """Compare the study's own settings, :data:`FOUND` and :data:`LARGER`; put each setting of FOUND back alone."""
    return {
        "columns": {name: _record(runs, guess) for name, guess in COLUMNS.items()},
        "put_back": [
            {"setting": name} | distance(cells(runs, FOUND._replace(**{name: value})))._asdict()
            for name, value in Guess()._asdict().items()
            if getattr(FOUND, name) != value
        ],
    }


def _record(runs: Runs, guess: Guess) -> Records:
    """A guess: its settings, its cells, how far they are from Table I, and figures that no search looked at."""
    rows = cells(runs, guess)
    only = INVERTERS._replace(k_q_mvar_per_pu_s=guess.k_q_mvar_per_pu_s)
    inverters = {n: figures(runs.run(scenario_of(runs, guess, n), only), guess)["deviation_pu"] for n in COUNTS}
    gains = [100.0 * (1.0 - row["deviation_pu"] / inverters[row["n_datacenters"]]) for row in rows]
    spread = [abs(row["std_pu"] - TABLE_ONE[row["n_datacenters"], row["k_p"]].std_pu) for row in rows]
    return {
        "settings": guess._asdict(),
        "cells": rows,
        **distance(rows)._asdict(),
        "std_error_pu": float(np.mean(spread)),
        "gain_pct": float(np.mean(gains)),
        "inverters_five_pu": inverters[COUNTS[-1]],
        "inside_least_pct": min(row["buses_inside_pct"] for row in rows),
        "inside_mean_pct": float(np.mean([row["buses_inside_pct"] for row in rows])),
    }

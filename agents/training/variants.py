"""Scenarios by name, and variants of them with other placements and ratings, for policies that must generalise."""

from __future__ import annotations

import numpy as np

from dcgrid_env import RandomFeeders, Scenario
from dcgrid_env.baselines.scenario_spec import ScenarioSpec


def scenarios(names: str, overrides: tuple[str, ...] = (), split: str = "train", **chosen: object) -> list[Scenario]:
    """Return the scenarios in a comma-separated string, with overrides ``FIELD=VALUE`` and further fields.

    Raises ValueError if a scenario is invalid or there is none.
    """
    given = [name.strip() for name in names.split(",") if name.strip()]
    if not given:
        raise ValueError(f"scenario: must name at least one scenario (dcgrid list), got {names!r}")
    return [ScenarioSpec(name, overrides).make(split, **chosen) for name in given]


def variant(scenario: Scenario, rng: np.random.Generator) -> Scenario:
    """Return the scenario with other placements, ratings and substation voltage.

    Data centres are placed at random in each episode, with 0.5 to 1.1 times their rating. Inverters are placed at other
    load buses, with 0.5 to 2 times their rating. The substation voltage changes by up to 0.01 p.u.
    """
    if isinstance(scenario.feeder, RandomFeeders):
        raise ValueError(f"vary: {scenario.name} has another feeder in each batch by itself; leave vary out")
    feeder, n_inv = scenario.feeder, scenario.inverters.count
    load_kw = np.bincount(feeder.node_bus[feeder.leg_node], feeder.p_load_kw, feeder.n_bus)
    loaded = [bus for i, bus in enumerate(feeder.bus_ids) if load_kw[i] > 0 and _has_phases(scenario, i)][1:]
    chosen = rng.choice(len(loaded), n_inv, replace=False)
    return scenario.replace(
        datacenters={
            "buses": None,
            "p_rated_kw": tuple(
                scenario.datacenters.parameters.p_rated_kw * rng.uniform(0.5, 1.1, scenario.datacenters.count)
            ),
        },
        inverters={
            "buses": tuple(loaded[i] for i in sorted(chosen)),
            "s_rated_kva": tuple(scenario.inverters.parameters.s_rated_kva * rng.uniform(0.5, 2.0, n_inv)),
        },
        source_voltage_pu=float(scenario.source_voltage_pu + rng.uniform(-0.01, 0.01)),
    )


def _has_phases(scenario: Scenario, position: int) -> bool:
    """Whether the bus at a position has all phases that inverters of the scenario are connected to."""
    needed = {phase for phases in scenario.inverters.phases or () for phase in phases}
    return not needed or needed <= set(scenario.feeder.bus_phases[position])

"""Small cases that together run every compiled kernel, and which kernels they left out; run as a program.

``python kernel_cases.py MODULE ...`` runs all cases and prints the kernels of these modules that were not compiled.
With ``NUMBA_BOUNDSCHECK=1`` an index outside an array raises IndexError instead of writing to other memory.
"""

import sys
from dataclasses import replace
from importlib import import_module
from typing import Any

import numpy as np
import torch
from numba.core.dispatcher import Dispatcher

from dcgrid_env import DcgridVectorEnv, Scenario, ThreePhaseFeeder, distflow, load_feeder, make_scenario
from dcgrid_env.baselines.registry import make_controller
from dcgrid_env.baselines.rollout import rollout
from dcgrid_env.grid.network import Network
from dcgrid_env.grid.three_phase_tables import CapacitorTable
from dcgrid_env.powerflow import Control, lindistflow, solve_unbalanced
from dcgrid_env.scenario.grid_control import GridControl
from dcgrid_env.traces.serving.hardware import replica
from dcgrid_env.traces.serving.pool import Pool
from helpers import three_phase
from helpers.looped import ieee33_with_ties
from helpers.nodal import as_nodal

WIDTHS = (1, 40, 130)
"""Environments in a batch: alone, in one block, and in blocks on two threads."""


def powers(feeder, n_row) -> Any:
    """Base loads, and a device at the last leg."""
    p_kw = np.tile(feeder.p_load_kw, (n_row, 1))
    p_kw[:, -1] += 1.0
    return p_kw, np.tile(feeder.q_load_kvar, (n_row, 1))


def balanced(feeder):
    """Solve, from a start as well, beyond what the feeder can carry, and differentiate; both methods."""
    for n_row in WIDTHS:
        p_kw, q_kvar = powers(feeder, n_row)
        solution = distflow(feeder, p_kw, q_kvar)
        distflow(feeder, p_kw, q_kvar, warm=solution)
        p_kw[0, -1] += 1e7
        distflow(feeder, p_kw, q_kvar)
        if not feeder.n_loop:
            lindistflow(feeder, p_kw, q_kvar)
    given = [torch.tensor(a, requires_grad=True) for a in powers(feeder, 2)]
    distflow(feeder, given[0], given[1]).v_pu.sum().backward()


def unbalanced(feeder):
    """Solve, from a start as well, beyond what the feeder can carry, and differentiate by all inputs."""
    for n_row in WIDTHS:
        p_kw, q_kvar = powers(feeder, n_row)
        ratio, state = np.ones((n_row, feeder.n_regulator)), np.ones((n_row, feeder.n_capacitor))
        solution = solve_unbalanced(feeder, p_kw, q_kvar, None, Control(tap_ratio=ratio, capacitor_on=state))
        solve_unbalanced(feeder, p_kw, q_kvar, start=solution)
        p_kw[0, -1] += 1e7
        solve_unbalanced(feeder, p_kw, q_kvar, max_sweeps=40)
        tensors: Any = [torch.tensor(a, requires_grad=True) for a in (*powers(feeder, n_row), ratio, state)]
        solution = solve_unbalanced(
            feeder, tensors[0], tensors[1], None, Control(tap_ratio=tensors[2], capacitor_on=tensors[3])
        )
        (solution.v_pu.sum() + solution.i_re_a.sum() + solution.loss_kw.sum()).backward()


def without_equipment(feeder):
    """The same feeder without capacitor banks."""
    return ThreePhaseFeeder.from_network(replace(feeder.network, capacitor=CapacitorTable()))


def with_exponents(feeder):
    """The same feeder with exponents of all loads."""
    table = feeder.network.phase_load
    n = len(table)
    loads = replace(table, model=["EXP"] * n, zip=[()] * n, exponents=[(0.8, 3.0)] * n)
    return ThreePhaseFeeder.from_network(replace(feeder.network, phase_load=loads))


def with_banks(feeder, bus, banks):
    """The same feeder with as many small banks at a bus, of one to three phases and of both connections in turn."""
    kinds = [("wye", (1.0, 0.0, 0.0)), ("wye", (1.0, 1.0, 0.0)), ("delta", (0.0, 1.0, 0.0)), ("wye", (1.0, 1.0, 1.0))]
    kinds = [kinds[k % len(kinds)] for k in range(banks)]
    table = CapacitorTable(
        [f"bank{k}" for k in range(banks)], [bus] * banks, [kind for kind, _ in kinds], [2.4] * banks,
        [kvar for _, kvar in kinds], ["on"] * banks,
    )  # fmt: skip
    return ThreePhaseFeeder.from_network(replace(feeder.network, capacitor=table))


def one_bus(feeder):
    """The source's bus alone, with nothing connected."""
    network = feeder.network if isinstance(feeder, ThreePhaseFeeder) else feeder.to_network()
    count = 3 if isinstance(feeder, ThreePhaseFeeder) else 1
    node = replace(network.node, **{k: getattr(network.node, k)[:count] for k in network.node.__dataclass_fields__})
    return type(feeder).from_network(Network(name="one bus", source=network.source, node=node))


def steps(scenario: Scenario, n_row=2):
    """Three steps of environments in a batch under random actions."""
    env = DcgridVectorEnv(n_row, scenario.replace(horizon=3, split="test"))
    env.action_space.seed(0)
    env.reset(seed=0)
    for _ in range(3):
        env.step(env.action_space.sample())


def serving():
    """Requests of one token and of many, none, and more than the replicas can take at once."""
    pool = Pool(replica("H100", "llama3-8b"), 1)
    for n in (0, 1, 500):
        pool.advance(np.zeros(n), np.full(n, 100), np.arange(n) % 50 + 1, 20)
    pool.rest()


def run():
    """Run all cases."""
    toy, khodr = load_feeder("toy6"), load_feeder("ieee123")
    for feeder in (toy, khodr, one_bus(toy), ieee33_with_ties(2)):
        balanced(feeder)
    ieee13 = load_feeder("ieee13-3ph")
    feeders = [load_feeder("ieee34-3ph"), three_phase.one_phase().feeder, one_bus(ieee13), without_equipment(ieee13)]
    nodal = [as_nodal(ieee13), as_nodal(with_exponents(without_equipment(ieee13)))]
    for feeder in (ieee13, *feeders, with_banks(ieee13, "675", 60), *nodal):
        unbalanced(feeder)
    for preset in ("toy6", "ieee13-3ph", "ieee123-3ph-day", "ride-through", "ieee33-weak-ups", "routing", "robust"):
        steps(make_scenario(preset))
    for preset in ("toy6", "ieee13-3ph"):
        steps(make_scenario(preset, reward="difference"))
    steps(make_scenario("toy6"), WIDTHS[-1])
    steps(make_scenario("ieee13-3ph"), WIDTHS[0])
    steps(three_phase.one_phase())
    set_points = {"grid_control.regulators": "setpoint", "grid_control.regulator_settings": {"timer": "reset"}}
    steps(make_scenario("ieee13-3ph", **set_points))
    control = GridControl(capacitors="controlled")
    steps(make_scenario("ieee13-3ph").replace(feeder=with_banks(ieee13, "675", 60), grid_control=control))
    serving()
    for preset, names in (("ieee33-weak", ("model-aided", "mpc")), ("toy6", ("model-aided", "mpc"))):
        scenario = make_scenario(preset, split="test", horizon=3)
        for name in names:
            rollout(scenario, make_controller(name, scenario), seeds=(0, 1))


def kernels(modules):
    """Compiled functions that these modules define, by their dotted names."""
    found = [(module, vars(import_module(module))) for module in modules]
    return {
        f"{module}.{name}": value
        for module, names in found
        for name, value in names.items()
        if isinstance(value, Dispatcher) and value.__module__ == module
    }


if __name__ == "__main__":
    run()
    for name, kernel in kernels(sys.argv[1:]).items():
        is_inlined = kernel.targetoptions.get("inline") == "always"
        if not kernel.signatures and not is_inlined:
            print(name)

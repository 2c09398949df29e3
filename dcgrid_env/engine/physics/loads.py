"""The other loads of a feeder and the noise on them, drawn for many rows at once."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from dcgrid_env.core import random
from dcgrid_env.core.cache import cached_on_owner
from dcgrid_env.core.threads import over_rows
from dcgrid_env.engine.physics.state import Exogenous, LoadsToDraw
from dcgrid_env.engine.physics.step_kernels import leg_loads
from dcgrid_env.grid import AnyFeeder, Feeder, ThreePhaseFeeder
from dcgrid_env.grid.random_feeders.feeder_batch import FeederBatch
from dcgrid_env.scenario.scenario import Scenario


class LoadNoise(NamedTuple):
    """Parameters of the load noise of a scenario, in the form that the kernel takes."""

    rho: float  # over one step
    sigma: float
    p_base_kw: np.ndarray
    q_base_kvar: np.ndarray
    q_fixed_kvar: np.ndarray


class BaseLegs(NamedTuple):
    """The loads of a three-phase feeder, which the noise of their buses scales."""

    bus: np.ndarray
    p_kw: np.ndarray
    q_kvar: np.ndarray


@cached_on_owner
def base_legs(feeder: ThreePhaseFeeder) -> BaseLegs:
    """Return the loads of a three-phase feeder."""
    return BaseLegs(feeder.leg_bus.copy(), feeder.p_load_kw.copy(), feeder.q_load_kvar.copy())


@cached_on_owner
def load_noise(scenario: Scenario) -> LoadNoise:
    """That of the scenario's own feeder."""
    return _load_of(scenario.feeder, scenario)


def _load_of(feeder: AnyFeeder, scenario: Scenario) -> LoadNoise:
    rho, sigma, zeros, ones = (
        float(scenario.background.load_rho**scenario.dt_s),
        float(scenario.background.load_sigma),
        np.zeros,
        np.ones,
    )
    if isinstance(feeder, ThreePhaseFeeder) or scenario.load_profiles.file is not None:  # a factor of each bus
        return LoadNoise(rho, sigma, ones(feeder.n_bus), zeros(feeder.n_bus), zeros(feeder.n_bus))
    fixed = -feeder.capacitor_kvar if scenario.background.capacitors else zeros(feeder.n_bus)
    return LoadNoise(rho, sigma, feeder.p_load_kw.copy(), feeder.q_load_kvar.copy(), fixed)


def drawn(scenario: Scenario, exogenous: Exogenous) -> tuple[Exogenous, np.ndarray]:
    """Draw the loads of an interval; return the interval with them, and the load noise at its end, (row, n_bus).

    ValueError if they are drawn already.
    """
    feeder, to_draw = scenario.feeder, exogenous.to_draw
    if to_draw is None:
        raise ValueError("the loads of this interval are drawn already")
    z, p, q = _process_and_loads(scenario, to_draw)
    capacitor_on = exogenous.capacitor_on
    if to_draw.p_kw is not None and to_draw.q_kvar is not None:
        factor = p if isinstance(feeder, Feeder) else p[:, feeder.leg_bus]
        p, q = factor * to_draw.p_kw, factor * to_draw.q_kvar
        if isinstance(feeder, Feeder) and scenario.background.capacitors:
            q = q - feeder.capacitor_kvar
    elif isinstance(feeder, ThreePhaseFeeder):
        p, q = leg_loads(p, *base_legs(feeder))
    if capacitor_on is not None and not isinstance(feeder, ThreePhaseFeeder):
        q += (1.0 - capacitor_on) * feeder.capacitor_kvar
        capacitor_on = None
    return exogenous._replace(p_load_kw=p, q_load_kvar=q, capacitor_on=capacitor_on, to_draw=None), z


def _process_and_loads(scenario: Scenario, to_draw: LoadsToDraw) -> np.ndarray:
    """Return the load noise and the loads, kW and kvar, (3, row, n_bus), see ``core.random.load_step``.

    On a three-phase feeder, and with load profiles, the second is the factor of each bus and the third 0.
    """
    key, step, noise, share = to_draw[:4]
    process_and_loads = np.empty((3, *noise.shape))
    z, p, q = process_and_loads[0], process_and_loads[1], process_and_loads[2]
    if isinstance(scenario.feeder, FeederBatch):
        for member, rows in scenario.feeder.members:
            process = np.empty((3, len(rows), noise.shape[1]))
            load = _load_of(member, scenario)
            random.load_step(key[rows], step[rows], noise[rows], share[rows], *load, process[0], process[1], process[2])
            process_and_loads[:, rows] = process
    else:
        load = load_noise(scenario)

        def part(a: int, b: int) -> int:
            return random.load_step(key[a:b], step[a:b], noise[a:b], share[a:b], *load, z[a:b], p[a:b], q[a:b])

        if len(step) == 1:
            random.load_step(key, step, noise, share, *load, z, p, q)
        else:
            over_rows(part, len(step))
    return process_and_loads

"""The perfect forecast of an episode: all external inputs, known at its beginning."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from dcgrid_env.core.digest import digest
from dcgrid_env.core.seeds import whole_seed
from dcgrid_env.scenario.errors import ScenarioError
from dcgrid_env.scenario.scenario import Scenario


class Forecast(NamedTuple):
    """What comes from outside in the steps 1 .. T of an episode; nothing here depends on an action."""

    buses: np.ndarray
    """Position in ``bus_ids`` of each agent's bus, (n_agent,)."""
    p_load_kw: np.ndarray
    """Other loads, kW, (T, n_leg)."""
    q_load_kvar: np.ndarray
    """Other loads, kvar, (T, n_leg); on a balanced feeder less capacitors."""
    p_ref_kw: np.ndarray
    """What the data centres would draw at the top clock with nothing queued, kW, (T, n_dc)."""
    p_inverter_kw: np.ndarray
    """Scheduled active injection of the inverters, kW, (T, n_inv)."""
    available: np.ndarray
    """1 for an agent that is connected to the grid and 0 for one that is not, (T, n_agent)."""
    capacitor_on: np.ndarray | None = None
    """``Exogenous.capacitor_on`` in each step, (T, n_capacitor); None where all can be on."""
    sags: np.ndarray | None = None
    """Sags in time: beginning, s from the episode's, duration, s, and share of the voltage left, (n_sag, 3)."""
    request: np.ndarray | None = None
    """Least and most total draw of the sites that the utility requests, shares of the sum of their ratings, (T, 2);
    None where a scenario has no requests."""


def forecast(scenario: Scenario, seed: int) -> Forecast:
    """The first episode of a seed, as every environment of the scenario draws it.

    ScenarioError for another type than Scenario, ValueError for a seed that is not a whole number of at least 0.
    """
    from dcgrid_env.engine.exogenous import episode  # brings the compiler with it, so not on import

    if not isinstance(scenario, Scenario):
        raise ScenarioError(f"scenario is {scenario!r}; give a Scenario, for instance make_scenario('ieee123')")
    seeds, scenario = np.array([whole_seed(seed) % 2**64], np.uint64), scenario.member(seed)
    drawn = episode.draw(scenario, seeds, np.zeros(1, np.uint64))
    steps, capacitors, requests = [], [], []
    for _, outside in episode.unroll(scenario, drawn):
        available = np.ones(scenario.n_agents) if outside.available is None else outside.available[0]
        fields = (outside.p_load_kw, outside.q_load_kvar, outside.p_ref_kw, outside.p_inverter_kw)
        steps.append((*(values[0] for values in fields), available))
        if outside.capacitor_on is not None:
            capacitors.append(outside.capacitor_on[0])
        if outside.request is not None:
            requests.append(outside.request[0, :2])
    columns = (np.array(column[1:]) for column in zip(*steps, strict=True))
    capacitor_on = np.array(capacitors[1:]) if capacitors else None
    sags = drawn.sag[0] if scenario.sags else None
    request = np.array(requests[1:]) if requests else None
    return Forecast(drawn.buses[0], *columns, capacitor_on=capacitor_on, sags=sags, request=request)


def sag_times(scenario: Scenario, seed: int) -> np.ndarray:
    """When the sags of a seed's first episode begin, s, (n_sag,); ValueError for a scenario without sags."""
    sags = forecast(scenario, seed).sags
    if sags is None:
        raise ValueError(f"scenario {scenario.name!r} has no sags; give it sags, such as 'virginia-2024'")
    return sags[:, 0]


def episode_hash(scenario: Scenario, seed: int) -> str:
    """SHA-256 of what comes from outside in the first episode of a seed, 16 hexadecimal digits.

    Figures are rounded to 2^-7 kW: should a machine's arithmetic differ in the last bit, a figure in some 10^10 falls
    to the other side.
    """
    drawn = forecast(scenario, seed)._asdict()
    there = ((name, values) for name, values in drawn.items() if values is not None)
    return digest((name, np.round(values * 2.0**7) + 0.0) for name, values in there)  # no negative zero

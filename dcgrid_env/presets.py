"""The named scenarios; their constants and what they are for stand in README.md."""

from __future__ import annotations

from functools import lru_cache
from typing import Any

from dcgrid_env.feeder import load_feeder
from dcgrid_env.scenario import Scenario, ScenarioError

PRESETS: dict[str, str] = {
    "toy6": "6 buses; one 2.5 MW data centre steps from idle to full at t = 20 s (the paper's Fig. 3)",
    "ieee123": "IEEE 123-bus equivalent, 5 data centres of 280 kW at random, 7 inverters (the paper's study)",
    "ieee33-weak": "33 buses of high r/x, 3 data centres of 1 MW at the ends; the clock must help",
}


def _toy6() -> Scenario:
    return Scenario(
        name="toy6",
        feeder=load_feeder("toy6"),
        v0_pu=1.0,
        n_datacenters=1,
        datacenter_buses=(4,),
        p_rated_kw=2500.0,
        s_rated_share=1.1,
        q_max_share=0.33,
        inverter_buses=(3, 5),
        inverter_s_kva=1000.0,
        trace="step",
        trace_window="start",
        load_sigma=0.02,
        horizon=100,
    )


def _ieee123() -> Scenario:
    return Scenario(
        name="ieee123",
        feeder=load_feeder("ieee123"),
        v0_pu=1.04375,
        n_datacenters=5,
        p_rated_kw=280.0,
        s_rated_share=1.1,
        q_max_share=0.33,
        inverter_buses=(2, 11, 40, 54, 87, 92, 103),
        inverter_s_kva=50.0,
    )


def _ieee33_weak() -> Scenario:
    return Scenario(
        name="ieee33-weak",
        feeder=load_feeder("ieee33"),
        v0_pu=1.05,
        n_datacenters=3,
        datacenter_buses=(18, 33, 25),
        p_rated_kw=1000.0,
        s_rated_share=1.02,
        q_max_share=0.33,
        inverter_buses=(7, 14, 20, 30),
        inverter_s_kva=100.0,
    )


_MAKERS = {"toy6": _toy6, "ieee123": _ieee123, "ieee33-weak": _ieee33_weak}


def make_scenario(scenario: str | Scenario, **overrides: Any) -> Scenario:
    """A preset by name, or a scenario of your own, with overrides of its fields.

    ``feeder`` may be given by name. The same call gives the same frozen object, so that what is derived from it is
    shared by all environments made alike. ScenarioError for an unknown name or field, listing those that exist.
    """
    try:
        return _made(scenario, tuple(overrides.items()))
    except TypeError:  # an override that cannot be a key, a list say
        return _make(scenario, overrides)


@lru_cache(maxsize=1024)
def _made(scenario: str | Scenario, overrides: tuple[tuple[str, Any], ...]) -> Scenario:
    return _make(scenario, dict(overrides))


def _make(scenario: str | Scenario, overrides: dict[str, Any]) -> Scenario:
    if isinstance(scenario, str):
        if scenario not in _MAKERS:
            raise ScenarioError(f"unknown scenario {scenario!r}; there are {', '.join(PRESETS)}")
        scenario = _MAKERS[scenario]()
    elif not isinstance(scenario, Scenario):
        raise ScenarioError(f"scenario is {scenario!r}; give a name ({', '.join(PRESETS)}) or a Scenario")
    if isinstance(overrides.get("feeder"), str):
        overrides = overrides | {"feeder": load_feeder(overrides["feeder"])}
    return scenario.replace(**overrides) if overrides else scenario

"""Scenarios with storages."""

from typing import Any

from dcgrid_env import Scenario, Storages, make_scenario

FIGURES: dict[str, Any] = {"p_rated_kw": 300.0, "energy_kwh": 5.0, "ageing_price": 0.05}


def ieee33_weak_ups(trace="code", **overrides) -> Scenario:
    """The preset ``ieee33-weak-ups``, with another workload if it is asked for."""
    return make_scenario("ieee33-weak-ups", **({} if trace == "code" else {"trace": trace}), **overrides)


def toy6_storage(horizon: int = 20, figures: dict | None = None, **overrides) -> Scenario:
    """toy6 with a storage of 300 kW and 5 kWh at the data centre's bus and one at a separate bus."""
    base = make_scenario("toy6", horizon=horizon)
    storages = Storages(buses=(4, 2), **(FIGURES | (figures or {})))
    return base.replace(name="toy6-storage", devices=(*base.devices, storages), **overrides)

"""Scenarios with storages."""

from dcgrid_env import Scenario, Storages, make_scenario

FIGURES = {"p_rated_kw": 300.0, "energy_kwh": 5.0, "ageing_price": 0.05}


def ieee33_weak_ups(**overrides) -> Scenario:
    """ieee33-weak with a UPS of 300 kW and 5 min at each data centre, half of it for the grid's use.

    These constants are a proposal of a preset; docs/storage.md says what controllers reach on it.
    """
    base = make_scenario("ieee33-weak")
    ups = Storages.ups(base.datacenter_buses, p_rated_kw=300.0, minutes=5.0, s_rated_kva=300.0, initial_share=0.8)
    return base.replace(name="ieee33-weak-ups", devices=(*base.devices, ups), **overrides)


def toy6_storage(horizon: int = 20, figures: dict | None = None, **overrides) -> Scenario:
    """toy6 with a storage of 300 kW and 5 kWh at the data centre's bus and one at a bus of its own."""
    base = make_scenario("toy6", horizon=horizon)
    storages = Storages(buses=(4, 2), **(FIGURES | (figures or {})))
    return base.replace(name="toy6-storage", devices=(*base.devices, storages), **overrides)

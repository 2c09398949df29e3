"""Build the scenario of ``--feeder``: devices chosen for the feeder, or the devices of another scenario."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

if TYPE_CHECKING:
    from dcgrid_env import Scenario
    from dcgrid_env.devices.device import Device


class FeederRequest(NamedTuple):
    """Options that define the scenario on a feeder."""

    feeder: str
    """Name of a bundled feeder or folder of the user's feeder."""
    scenario: str | None = None
    """Scenario whose devices are placed on the feeder; None to choose devices for the feeder."""
    datacenters: str | None = None
    """Data centres in words such as "3 x 1 MW at ends"; None to choose them for the feeder."""
    inverters: str | None = None
    """Inverters in words such as "5 x 200 kvar"; None to choose them for the feeder."""


def scenario_on_feeder(
    request: FeederRequest, overrides: tuple[str, ...], split: str, chosen: dict[str, Any]
) -> Scenario:
    """Return the scenario on a feeder.

    The source voltage is that of the feeder's file; for bundled feeders see ``source_voltage.default_voltage``.

    Parameters
    ----------
    request
        Feeder and devices.
    overrides, split, chosen
        Fields to override, split of the episodes, and fields that the command sets, as for ``ScenarioSpec.make``.

    Raises
    ------
    ValueError
        If the feeder does not exist or cannot be read, the devices do not fit on it, or a field is invalid.
    """
    from dcgrid_env import scenario_on
    from dcgrid_env.baselines.scenario_spec import ScenarioSpec, read_overrides, varied
    from dcgrid_env.baselines.source_voltage import default_voltage
    from dcgrid_env.scenario.on_feeder import power_flow_of

    feeder, scenario = request.feeder, request.scenario
    values = read_overrides(overrides)
    if "feeder" in values:
        raise ValueError("set: must not contain feeder together with --feeder; give it once")
    built = _feeder(feeder)
    if scenario is None:
        on_it = varied(scenario_on(built, request.datacenters, request.inverters), overrides, split, chosen)
        return on_it if "source_voltage_pu" in values else default_voltage(on_it)
    for option in ("datacenters", "inverters"):
        if getattr(request, option) is not None:
            raise ValueError(
                f"{option}: must not be combined with --scenario {scenario}, which defines the devices; remove one"
            )
    base = ScenarioSpec(scenario).make(split)
    _check_buses(base, built, scenario, values)
    more = [f"feeder={json.dumps(feeder)}"]
    if "power_flow" not in values and type(base.feeder) is not type(built):
        more.append(f"power_flow={power_flow_of(built)}")
    return ScenarioSpec(scenario, (*overrides, *more)).make(split, **chosen)


def _feeder(named: str) -> Any:
    """Return a feeder by name or folder; raise FeederError if it does not exist or cannot be read."""
    from dcgrid_env import FeederError
    from dcgrid_env.scenario.serialization import feeder_from_data

    if not named.strip():
        raise ValueError("feeder: must not be empty; give a feeder's name or folder")
    try:
        return feeder_from_data(named)
    except FeederError as error:
        raise FeederError(f"feeder {named}: {error}" if Path(named).is_dir() else str(error)) from None


def _check_buses(base: Scenario, feeder: Any, named: str, values: dict[str, Any]) -> None:
    """Raise ValueError if the scenario's devices are at buses that the feeder lacks and that are not overridden."""
    from dcgrid_env.scenario.placement import path_of

    if "devices" in values:
        return
    there = set(feeder.bus_ids)
    for device in base.devices:
        path = path_of(device)
        field = f"{path}.buses"
        lacking = [bus for bus in device.buses or () if bus not in there]
        if lacking and field not in values and "buses" not in (values.get(path) or {}):
            raise ValueError(
                f"feeder {feeder.name!r} lacks {_list(lacking)}, where scenario {named!r} has devices ({field}); "
                f"remove --scenario to choose devices for the feeder, or pass --set '{field}=[..]' with its buses"
            )


def chosen_line(scenario: Scenario) -> str:
    """Return a line with the feeder, its devices and their sizes, and the power flow."""
    from dcgrid_env import Feeder
    from dcgrid_env.scenario.grid_control import regulator_deciders
    from dcgrid_env.scenario.on_feeder import base_load_kw

    feeder = scenario.feeder
    balanced = isinstance(feeder, Feeder)
    groups = [_group(device, scenario, balanced) for device in scenario.devices if device.count]
    kind = "balanced" if balanced else "three-phase"
    grid = [f"power flow {scenario.power_flow}"]
    if not balanced and feeder.n_regulator:
        modes = Counter(regulator_deciders(scenario.grid_control, feeder))
        counts = ", ".join(f"{n} {mode}" for mode, n in modes.items())
        grid.append(f"regulators {counts if len(modes) > 1 else next(iter(modes))}")
    return (
        f"{kind} feeder {feeder.name}, {feeder.n_bus} buses, {base_load_kw(feeder):.0f} kW of load: "
        f"{'; '.join(groups)}; {', '.join(grid)}; use --set to change fields"
    )


def _group(device: Device, scenario: Scenario, balanced: bool) -> str:
    """Return a group of devices in words: number, size and buses."""
    names = {"datacenter": ("data centre", "kW"), "inverter": ("inverter", "kVA")}
    name, unit = names.get(device.kind, (device.kind, "kW"))
    ratings = sorted({f"{rating:g}" for rating in device.p_scale_kw}, key=float)
    size = f"{ratings[0]} {unit}" if len(ratings) == 1 else f"{ratings[0]} to {ratings[-1]} {unit}"
    where = f"at {_list(device.buses)}" if device.buses is not None else ""
    if device.buses is None:
        phases = "" if balanced or getattr(device, "phases", None) else " of three phases"
        where = f"drawn among {len(scenario.candidates)} load buses{phases}"
    return f"{device.count} {name}{'s' * (device.count > 1)} of {size} {where}"


_SHOWN = 8


def _list(buses: Sequence[int | str]) -> str:
    more = [f"{len(buses) - _SHOWN} more"] * (len(buses) > _SHOWN)
    return f"bus{'es' * (len(buses) > 1)} {', '.join([*map(str, buses[:_SHOWN]), *more])}"

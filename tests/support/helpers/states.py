"""States of scenarios with a group of data centres and one of inverters, written and read by field."""

from typing import Any

from dcgrid_env.devices.datacenter.datacenter import DataCenterState
from dcgrid_env.engine.physics.state import State


def state_of(fields: dict[str, Any]) -> State:
    """Build a state from its fields and those of the data centres."""
    sites = DataCenterState(**{name: fields[name] for name in DataCenterState._fields})
    own = {name: value for name, value in fields.items() if name not in DataCenterState._fields}
    return State(**own, devices=(sites, ()))


def fields_of(state: State) -> dict[str, Any]:
    """Every array of a balanced feeder's state by its name, where no ramp is charged and no rating is known."""
    apart = ("devices", "three_phase", "p_window_kw", "loading", "regulator_views", "request")
    found = {name: getattr(state, name) for name in State._fields if name not in apart}
    for device in state.devices:
        found |= device._asdict() if hasattr(device, "_asdict") else {}
    return found


def with_fields(state: State, **changes: Any) -> State:
    """A state with other arrays in some fields."""
    return state_of(fields_of(state) | changes)

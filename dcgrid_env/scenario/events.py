"""Checks that the faults and sags of a scenario fit its devices and feeder."""

from __future__ import annotations

from typing import Any

from dcgrid_env.core.checked import refuse
from dcgrid_env.devices.device import may_leave
from dcgrid_env.devices.faults import CAPACITOR, Fault
from dcgrid_env.devices.grid_equipment import is_equipment
from dcgrid_env.devices.ride_through.sags import Sag
from dcgrid_env.scenario.errors import ScenarioError


def check_events(scenario: Any) -> None:
    """Raise FieldError or ScenarioError for invalid faults and sags, or those that affect nothing in the scenario."""
    if not isinstance(scenario.faults, tuple) or not all(isinstance(fault, Fault) for fault in scenario.faults):
        raise refuse(scenario, "faults", "give a tuple of Fault, () for none")
    can_be_lost = [device for device in scenario.devices if not is_equipment(device)]
    kinds = (*(device.kind for device in can_be_lost), CAPACITOR)
    agents = scenario.agents[: sum(device.count for device in can_be_lost)]
    for fault in scenario.faults:
        for among in fault.among:
            if among not in kinds and among not in agents:
                there = (*(device.kind for device in can_be_lost if device.count), CAPACITOR)
                raise ScenarioError(
                    f"scenario {scenario.name!r}: a fault among {among!r}; choose {', '.join(there)} or an agent, "
                    f"{', '.join(agents)}"
                )
    for fault, targets in zip(scenario.faults, scenario.fault_targets, strict=True):
        if not len(targets):
            struck = ", ".join(fault.among)
            raise ScenarioError(
                f"scenario {scenario.name!r}: a fault among {struck}, of which there is none; name others"
            )
    _check_sags(scenario)


def _check_sags(scenario: Any) -> None:
    if not isinstance(scenario.sags, tuple) or not all(isinstance(sag, Sag) for sag in scenario.sags):
        raise refuse(scenario, "sags", "give a tuple of Sag, () for none, or the name of a sequence")
    if not scenario.sags:
        return
    if scenario.sags[0].since == "previous":
        raise ScenarioError(
            f"scenario {scenario.name!r}: sags[0].since is 'previous', but none is listed before it; give 'episode'"
        )
    with_curve = [device for device in scenario.devices if may_leave(device)]
    if not any(device.count for device in with_curve):
        remedy = "give datacenters.ride_through or inverters.ride_through"
        if with_curve:
            remedy = f"there is no {' and no '.join(device.kind for device in with_curve)}: give at least one"
        raise ScenarioError(
            f"scenario {scenario.name!r}: sags is given, but no device has a curve that they are held against; {remedy}"
            ", or leave sags out"
        )

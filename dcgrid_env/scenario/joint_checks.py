"""Checks of a scenario whose parts are each valid but may not fit together."""

from __future__ import annotations

from typing import Any

from dcgrid_env.core.checked import FieldError, refuse
from dcgrid_env.devices.device import may_leave
from dcgrid_env.devices.faults import CAPACITOR
from dcgrid_env.devices.grid_equipment import is_equipment
from dcgrid_env.grid import AnyFeeder, Feeder, FeederError, ThreePhaseFeeder
from dcgrid_env.grid.random_feeders.family import RandomFeeders
from dcgrid_env.powerflow import has_ratings
from dcgrid_env.scenario.costs.grid_terms import TERMS

MOST_STEPS = 10_000
"""Longest window in steps. It may reach beyond an episode: before it a site has always drawn what it draws at t = 0."""


def check_feeder_kind(scenario: Any) -> None:
    """Raise FieldError for a wrong type, another kind's power flow, or what the kind of feeder lacks."""
    feeder, sensing = scenario.feeder, scenario.sensing
    if not isinstance(feeder, AnyFeeder | RandomFeeders):
        raise refuse(scenario, "feeder", "give a feeder, load_feeder(name) or read_feeder(folder), or RandomFeeders")
    balanced = not isinstance(feeder, ThreePhaseFeeder)
    kind = "balanced" if balanced else "three-phase"
    if balanced == (scenario.power_flow == "sweep"):
        methods = "'distflow' or 'lindistflow'" if balanced else "'sweep'"
        raise refuse(scenario, "power_flow", f"give {methods} for the {kind} feeder {feeder.name!r}")
    if scenario.power_flow == "lindistflow" and isinstance(feeder, Feeder) and feeder.n_loop:
        raise refuse(scenario, "power_flow", f"give 'distflow' for feeder {feeder.name!r}, which has loops")
    if sensing.regulator and (balanced or not len(feeder.network.regulator)):
        remedy = f"the {kind} feeder {feeder.name!r} has no regulator; give a three-phase feeder with regulators, or "
        raise FieldError("Scenario", "sensing.regulator", True, f"{remedy}leave it out")
    has = {
        "": True,
        "three phases": not balanced,
        "ratings": isinstance(feeder, AnyFeeder) and has_ratings(feeder),
    }
    lacking = {
        "three phases": f"set it to 0: the balanced feeder {feeder.name!r} has no such term",
        "ratings": f"feeder {feeder.name!r} has no rated branch; give its branches rating_a, or leave it out",
    }
    for term in TERMS:
        if (weight := getattr(scenario.cost.weights, term.name)) and not has[term.needs]:
            raise FieldError("Scenario", f"cost.weights.{term.name}", weight, lacking[term.needs])
    if sensing.loading and not has["ratings"]:
        raise FieldError("Scenario", "sensing.loading", True, lacking["ratings"])
    if isinstance(feeder, RandomFeeders):
        if sensing.observe == "feeder":
            remedy = "each of its random feeders has its buses elsewhere; choose 'local' or 'neighbours'"
            raise FieldError("Scenario", "sensing.observe", "feeder", remedy)
        feeder.style_of(scenario.generator_split)


def check_model(scenario: Any) -> None:
    """Raise FieldError for switches of the model that the feeder does not have, or that leave an island."""
    sensing = scenario.sensing
    name = "sensing.model_open" if sensing.model_open else "sensing.model_closed"
    value = sensing.model_open or sensing.model_closed
    if not value:
        return
    if not isinstance(scenario.feeder, Feeder):
        remedy = "its branches are not those of one balanced feeder; leave it out"
        raise FieldError("Scenario", name, value, f"feeder {scenario.feeder.name!r}: {remedy}")
    try:
        _ = scenario.model
    except FeederError as error:
        raise FieldError("Scenario", name, value, f"the model is no feeder: {error}") from None


def check_ramp_limit(scenario: Any) -> None:
    """Raise FieldError for a limit without a site, or a window that no whole number of steps makes up."""
    if scenario.cost.ramp_limit_kw_per_s is not None and not scenario.n_sites:
        limit = scenario.cost.ramp_limit_kw_per_s
        raise FieldError("Scenario", "cost.ramp_limit_kw_per_s", limit, "leave it out: the scenario has no data centre")
    window_s, dt_s = scenario.cost.ramp_window_s, scenario.dt_s
    if window_s is None:
        return
    steps = round(window_s / dt_s)
    if not 1 <= steps <= MOST_STEPS or abs(steps * dt_s - window_s) > 1e-6 * window_s:
        remedy = f"give a whole number of steps of {dt_s:g} s, {MOST_STEPS:,} of them at most"
        raise FieldError("Scenario", "cost.ramp_window_s", window_s, remedy)


def check_groups(devices: tuple[Any, ...], horizon: int, dt_s: float) -> None:
    """Raise FieldError for two groups of a kind or of one source, or a name that is the grid's or another group's."""
    kinds = [device.kind for device in devices]
    for kind in kinds:
        if kinds.count(kind) > 1:
            raise _refused(f"more than one group is of kind {kind!r}; give one, with a rating for each slot")
    for source in ("workload", "injection"):
        if sum(device.input == source for device in devices) > 1:
            raise _refused(f"more than one group is driven by {source}; give one, with a rating for each slot")
    of_grid, terms = {term.name for term in TERMS if term.amount is not None}, dict[str, str]()
    for device in devices:
        cost_names = [term.name for term in device.cost_terms(horizon, dt_s)]
        for name in (*cost_names, *(field.name for field in device.fields(horizon, dt_s))):
            if name in of_grid:
                raise _refused(f"{device.kind!r} calls something {name!r}, which is the grid's; rename it")
        for name in cost_names:
            if terms.setdefault(name, device.kind) != device.kind:
                raise _refused(f"{terms[name]!r} and {device.kind!r} both have a cost term {name!r}; rename one")


def _refused(remedy: str) -> FieldError:
    return FieldError("Scenario", "devices", ..., f"cannot be: {remedy}")


def check_faults(scenario: Any) -> None:
    """Raise FieldError for faults of what the scenario does not have."""
    can_be_lost = [device for device in scenario.devices if not is_equipment(device)]
    kinds = [device.kind for device in can_be_lost]
    agents = scenario.agents[: sum(device.count for device in can_be_lost)]
    there = ", ".join((*(device.kind for device in can_be_lost if device.count), CAPACITOR))
    for i, fault in enumerate(scenario.faults):
        for among in fault.among:
            if among not in (*kinds, CAPACITOR, *agents):
                remedy = f"choose {there} or an agent, {', '.join(agents)}"
                raise FieldError("Scenario", f"faults[{i}].among", among, remedy)
        if not len(scenario.fault_targets[i]):
            raise FieldError("Scenario", f"faults[{i}].among", fault.among, "there is none of these; name others")


def check_sags(scenario: Any) -> None:
    """Raise FieldError for sags that follow nothing, or that no device has a curve for."""
    if not scenario.sags:
        return
    if scenario.sags[0].since == "previous":
        raise FieldError("Scenario", "sags[0].since", "previous", "none is listed before it; give 'episode'")
    with_curve = [device for device in scenario.devices if may_leave(device)]
    if not any(device.count for device in with_curve):
        remedy = "give datacenters.ride_through or inverters.ride_through"
        if with_curve:
            remedy = f"there is no {' and no '.join(device.kind for device in with_curve)}: give at least one"
        wrong = f"is given, but no device has a curve that decides whether it trips; {remedy}, or leave sags out"
        raise FieldError("Scenario", "sags", ..., wrong)

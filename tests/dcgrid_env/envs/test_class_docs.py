"""The docstrings of the environment classes: their sections, and tables that agree with the code."""

import dataclasses
import itertools
from typing import Any

import numpy as np
import pytest

from dcgrid_env import (
    CostWeights,
    DcgridEnv,
    DcgridParallelEnv,
    DcgridVectorEnv,
    Storages,
    action_layout,
    field_names,
    make_scenario,
    parallel_env,
)
from dcgrid_env.envs.class_docs import CHANNELS, FEATURES, FIELDS, INFO, OF_STEP

CLASSES = (DcgridEnv, DcgridParallelEnv, DcgridVectorEnv)
SECTIONS = [
    "Problem", "Action space", "Observation space", "Reward", "Starting state", "Episode end", "Information",
    "Parameters", "Examples",
]  # fmt: skip
SETTINGS: dict[str, Any] = {
    "sensing.loading": {"sensing": {"loading": True}},
    "grid_request": {"grid_request": {"targets": [{"value_share": 0.5}]}},
    "clock_law of two classes": {"datacenters.clock_law": "prefill-decode"},
    "ride_through (data centre)": {"datacenters.ride_through": {"curve": "itic", "release": "agent"}},
    "ride_through (inverter)": {"inverters.ride_through": {"curve": "ieee1547-cat2"}},
    "smoothing": {"datacenters.smoothing": {"control": "agent"}},
    "cooling": {"datacenters.cooling": {}},
    "routing": {"datacenters.routing": {}},
    "batching": {"datacenters.batching": {}},
    "service": {"datacenters.service": {}},
    "storage (data centre)": {"datacenters.storage": {"p_rated_kw": 300.0, "energy_kwh": 5.0}},
}
"""A setting for each feature that a setting adds."""


@pytest.mark.parametrize("kind", CLASSES)
def test_a_docstring_has_all_sections_and_their_parts(kind):
    lines = kind.__doc__.splitlines()
    titles = [title for title, rule in itertools.pairwise(lines) if rule and set(rule) == {"-"}]
    assert titles == SECTIONS
    assert lines[0].startswith("Voltage control of ")
    assert "{problem}" not in kind.__doc__
    assert all(name in kind.__doc__ for name, *_ in (*CHANNELS, *FIELDS, *FEATURES, *INFO))
    for name, weight in CostWeights._field_defaults.items():
        assert f"{name.ljust(19)}  {weight:g} " in kind.__doc__
    assert max(map(len, lines)) <= 120
    assert not any(line != line.rstrip() for line in lines)


def names(rows, agents):
    return [name for name, whose, *_ in rows if whose == "all" or agents in whose]


@pytest.mark.slow
def test_channels_and_fields_are_those_of_the_code():
    scenario = make_scenario("ieee33", datacenters={"boost_share": 1.3}, cost={"band_pu": 0.04})
    env = parallel_env(scenario)
    for agent, of in (("dc_0", "data centre"), ("inv_0", "inverter")):
        assert [channel for at, channel in action_layout(scenario).names if at == agent] == names(CHANNELS, of)
        assert list(field_names(scenario)[agent]) == names(FIELDS, of)
        space: Any = env.observation_space(agent)
        known = {"band": 0.04, "boost_share": 1.3, "horizon": scenario.horizon, "dt_s": scenario.dt_s}
        for name, low, high in zip(names(FIELDS, of), space.low, space.high, strict=True):
            lowest, highest = next(row[2] for row in FIELDS if row[0] == name).split(" .. ")
            assert low == pytest.approx(eval(lowest, known.copy()))
            if highest == "largest":
                assert 0.0 < high < np.inf
            elif name != "backlog":
                assert high == pytest.approx(eval(highest, known.copy()))
            else:
                assert high >= scenario.horizon * scenario.dt_s


def keys(scenario, **overrides):
    """Keys of the info of a reset, and of a step."""
    env = DcgridEnv(scenario, **overrides)
    begun = env.reset(seed=0)[1]
    return list(begun), list(env.step(env.action_space.sample())[-1])


def terms(scenario):
    return {name.removeprefix("cost_") for name in keys(scenario)[1] if name.startswith("cost_")}


def added(scenario, before):
    """What a scenario has beyond another: channels, fields and cost terms."""
    channels = {channel for _, channel in action_layout(scenario).names}
    fields = {name for of in field_names(scenario).values() for name in of}
    was = {name for of in field_names(before).values() for name in of}
    return (
        channels - {channel for _, channel in action_layout(before).names},
        fields - was,
        terms(scenario) - terms(before),
    )


def row(feature):
    texts = next(texts for name, *texts in FEATURES if name == feature)
    return tuple({name.strip() for name in text.split(",") if name.strip()} for text in texts)


@pytest.mark.parametrize("feature", SETTINGS)
def test_what_a_feature_adds_is_what_the_table_lists(feature):
    before = make_scenario("ieee33-weak")
    rated = dataclasses.replace(before.feeder, rating_a=np.full(before.feeder.n_branch, 400.0))
    before = before.replace(feeder=rated)
    assert added(before.replace(**SETTINGS[feature]), before) == row(feature)


@pytest.mark.slow
def test_what_further_devices_add_is_what_the_table_lists():
    before = make_scenario("ieee33-weak")
    storages = Storages(buses=("18",), p_rated_kw=100.0, energy_kwh=50.0, s_rated_kva=120.0)
    channels, fields, costs = added(before.replace(devices=(*before.devices, storages)), before)
    assert (channels | {"q"}, fields, costs) == row("device storage")
    agents = {"grid_control.regulators": "agent", "grid_control.capacitors": "agent"}
    assert added(make_scenario("ieee123-3ph", **agents), before)[:2] == tuple(
        row("three-phase feeder")[i] | row("device tap_changer")[i] | row("device capacitor_bank")[i] for i in (0, 1)
    )
    assert added(make_scenario("ieee123-3ph-day"), make_scenario("ieee123-3ph"))[:2] == tuple(
        row("device regulator_setpoint")[i] | row("device capacitor_setpoint")[i] for i in (0, 1)
    )
    assert terms(make_scenario("ieee13-3ph")) - terms(before) == row("three-phase feeder")[2]


def test_what_observed_regulators_add_is_what_the_table_lists():
    before = make_scenario("ieee13-3ph")
    assert added(before.replace(sensing={"regulator": True}), before) == row("sensing.regulator")


def test_every_feature_has_a_test():
    equipment = ("tap_changer", "capacitor_bank", "regulator_setpoint", "capacitor_setpoint")
    further = {"device storage", *(f"device {kind}" for kind in equipment)}
    tested = {"three-phase feeder", "sensing.regulator", *further, *SETTINGS}
    assert {feature for feature, *_ in FEATURES} == tested


@pytest.mark.parametrize("name", ["ieee33", "ieee13-3ph"])
def test_keys_of_info(name):
    listed = {key for listing, _ in INFO for key in listing.split(", ")}
    found = set()
    begun, stepped = keys(name, reward="difference")
    for key in stepped:
        if not key.startswith("bus_"):
            start = key.partition("_")[0]
            found.add(
                key if key in listed else {"cost": "cost_TERM", "tap": "tap_NAME", "capacitor": "capacitor_NAME"}[start]
            )
    assert found == {
        key
        for listing, text in INFO
        if ("3ph" in name or "three-phase" not in text) and "grid_request" not in text
        for key in listing.split(", ")
    }
    of_steps = {key for listing, text in INFO if text.endswith(OF_STEP) for key in listing.split(", ")}
    assert {key for key in stepped if key in of_steps or key.startswith("cost_")} == set(stepped) - set(begun)

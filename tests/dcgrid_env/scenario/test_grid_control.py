"""Who decides over regulators and capacitor banks: given in any way, kept in files, refused by name."""

import pickle
from dataclasses import replace

import pytest

from dcgrid_env import FeederError, ScenarioError, ThreePhaseFeeder, acting_relays, make_scenario, scenario_hash
from dcgrid_env.devices.capacitor_bank.capacitor_control import CapacitorControl
from dcgrid_env.scenario.grid_control import GridControl, capacitor_deciders, regulator_deciders
from helpers.three_phase import ieee13, ieee123

GIVEN = {
    "agents": {"grid_control.regulators": "agent", "grid_control.capacitors": "agent"},
    "by bank": {
        "grid_control.regulators": {"reg4": "agent", "reg1a": "fixed"},
        "grid_control.capacitors": {"c83": "controlled"},
    },
    "settings": {
        "grid_control.capacitors": "controlled",
        "grid_control.capacitor_settings": {"measures": "kvar", "delay_s": 30.0},
    },
    "set points": {
        "grid_control.regulators": {"reg1a": "setpoint", "reg3": "agent"},
        "grid_control.capacitors": "setpoint",
        "grid_control.regulator_settings": {"timer": "integrating", "offset_v": {"reg1a": 2.0}, "hold_s": 300.0},
        "grid_control.capacitor_settings": {"hold_s": 900.0},
    },
    "a schedule": {
        "grid_control.regulator_settings": {
            "timer": "reset",
            "offset_v": {"reg1a": [[6.0, 1.5], [22, -0.5]], "reg3": 1.0},
        },
        "background.start_hour": 5.0,
        "grid_control.capacitors": "agent",
    },
}


def test_defaults_change_nothing():
    scenario = ieee123()
    assert scenario.grid_control == GridControl()
    assert set(regulator_deciders(scenario.grid_control, scenario.feeder)) == {"controlled"}
    assert set(capacitor_deciders(scenario.grid_control, scenario.feeder)) == {"fixed"}
    assert [device.kind for device in scenario.devices] == ["datacenter", "inverter"]
    assert scenario_hash(scenario.replace(grid_control=GridControl())) == scenario_hash(scenario)
    assert scenario_hash(scenario.replace(grid_control={"regulators": "fixed"})) != scenario_hash(scenario)


@pytest.mark.parametrize("name", GIVEN)
def test_paths_mappings_and_files_are_one_thing(name, tmp_path):
    flat = ieee123().replace(**GIVEN[name])
    parts: dict[str, dict[str, object]] = {}
    for key, value in GIVEN[name].items():
        parts.setdefault(key.split(".")[0], {})[key.split(".")[1]] = value
    by_mapping = ieee123().replace(**parts)
    assert by_mapping.difference(flat) is None
    assert flat.difference(ieee123()) is not None
    assert pickle.loads(pickle.dumps(flat)).difference(flat) is None
    flat.to_toml(tmp_path / "mine.toml")
    read = make_scenario(str(tmp_path / "mine.toml"))
    assert read.replace(name=flat.name).difference(flat) is None
    assert scenario_hash(read.replace(name=flat.name)) == scenario_hash(flat) != scenario_hash(ieee123())
    text = (tmp_path / "mine.toml").read_text()
    assert not any(kind in text for kind in ("tap_changer", "regulator_setpoint", "capacitor_setpoint"))


def test_agents_come_and_go_with_the_decision():
    scenario = ieee123().replace(grid_control={"regulators": {"reg4": "agent"}})
    assert [device.kind for device in scenario.devices] == ["datacenter", "inverter", "tap_changer"]
    assert scenario.agents[-3:] == ("reg_0", "reg_1", "reg_2")
    assert scenario.devices[-1].phases == ("a", "b", "c")
    ganged = ieee123().replace(grid_control={"regulators": {"reg1a": "agent"}}).devices[-1]
    assert (ganged.buses, ganged.phases) == (("150r",), ("abc",))
    assert scenario.replace(devices=scenario.devices).difference(scenario) is None
    assert scenario.replace(grid_control={"regulators": "controlled"}).difference(ieee123()) is None
    assert len(scenario.candidates) == len(ieee123().candidates)


def test_a_bank_whose_set_point_is_chosen_is_one_agent():
    scenario = ieee123().replace(**GIVEN["set points"])
    assert scenario.agents[-7:] == ("reg_0", "reg_1", "regset_0", "capset_0", "capset_1", "capset_2", "capset_3")
    regulators, banks = scenario.devices[-2:]
    assert (regulators.kind, regulators.names, regulators.members) == ("regulator_setpoint", ("reg1a",), ((0,),))
    assert (regulators.rest_offset_v, regulators.hold_s) == ((2.0,), 300.0)
    assert (banks.kind, banks.count, banks.hold_s) == ("capacitor_setpoint", 4, 900.0)
    assert scenario.replace(devices=scenario.devices).difference(scenario) is None
    three = ieee123().replace(grid_control={"regulators": "setpoint", "regulator_settings": {"timer": "reset"}})
    assert three.devices[-1].names == ("reg1a", "reg2", "reg3", "reg4")
    assert (three.devices[-1].buses[3], three.devices[-1].phases[3]) == ("160r", "abc")


@pytest.mark.parametrize(
    ("given", "message"),
    [
        (
            {"grid_control.regulators": "on"},
            "grid_control.regulators is 'on'; give one of fixed, controlled, agent, setpoint",
        ),
        (
            {"grid_control.regulators": {"reg9": "agent"}},
            "feeder 'ieee123-3ph' has no bank 'reg9'; there are reg1a, reg2, reg3, reg4",
        ),
        (
            {"grid_control.capacitors": {"c83": "off"}},
            "grid_control.capacitors is .*give one of fixed, controlled, agent, setpoint",
        ),
        (
            {"grid_control.capacitors": "agent", "background.capacitors": False},
            "the background has its capacitors disconnected",
        ),
        (
            {"grid_control.capacitor_settings": {"delay": 1.0}},
            "grid_control.capacitor_settings.delay is no field; did you mean delay_s",
        ),
        ({"grid_control.capacitor_settings": {"delay_s": -1.0}}, "capacitor_settings.delay_s is -1.0"),
        ({"grid_control.capacitor_settings": 3}, r"grid_control.capacitor_settings is 3; give CapacitorControl\(...\)"),
        (
            {"grid_control.capacitors": "setpoint", "grid_control.capacitor_settings": {"measures": "kvar"}},
            "for mode 'setpoint' set grid_control.capacitor_settings.measures to 'voltage', it is 'kvar'",
        ),
        (
            {"grid_control.regulator_settings": {"timer": "reset", "offset_v": {"reg2": [[6.0, 1.0]]}}},
            "grid_control.regulator_settings.offset_v is .*; a schedule needs the hour of the day; set background",
        ),
        (
            {
                "grid_control.regulator_settings": {"timer": "reset", "offset_v": {"reg2": [[6.0, 1.0]]}},
                "grid_control.regulators": {"reg2": "setpoint"},
                "background.start_hour": 0.0,
            },
            "a schedule needs a bank in mode 'controlled', 'reg2' is in mode 'setpoint'",
        ),
        *(
            (
                {"grid_control.regulator_settings": {"timer": "reset", "offset_v": {"reg2": schedule}}},
                "or to lists of .hour, volts. with rising hours from 0 to less than 24",
            )
            for schedule in ([], [[24.0, 1.0]], [[6.0, 1.0], [6.0, 2.0]], [[6.0, 13.0]], [6.0, 1.0], [["6", 1.0]])
        ),
        (
            {"grid_control.regulator_settings": {"timer": "reset", "offset_v": {"reg9": 1.0}}},
            "feeder 'ieee123-3ph' has no bank or regulator 'reg9'; there are reg1a, reg2, reg3, reg4, creg1a",
        ),
        (
            {"grid_control.regulator_settings": {"hold_s": 59.0}},
            "grid_control.regulator_settings.hold_s is 59.0",
        ),
        ({"grid_control.capacitor_settings": {"hold_s": 10.0}}, "grid_control.capacitor_settings.hold_s is 10.0"),
        (
            {
                "grid_control.regulators": "setpoint",
                "grid_control.regulator_settings": {"timer": "reset"},
                "faults": [{"among": ["regset_0"], "begin_s": [1, 2]}],
            },
            "among is 'regset_0'; choose",
        ),
        (
            {"grid_control.regulators": "agent", "faults": [{"among": ["tap_changer"], "begin_s": [1, 2]}]},
            "among is 'tap_changer'; choose",
        ),
        (
            {"grid_control.regulators": "agent", "faults": [{"among": ["reg_0"], "begin_s": [1, 2]}]},
            "among is 'reg_0'; choose",
        ),
    ],
)
def test_what_cannot_be_is_refused_by_name(given, message):
    with pytest.raises(ScenarioError, match=message):
        ieee123().replace(**given)


@pytest.mark.parametrize("given", [{"grid_control.regulators": "fixed"}, {"grid_control.capacitors": "agent"}])
def test_a_balanced_feeder_has_nothing_to_control(given):
    with pytest.raises(ScenarioError, match="the balanced feeder 'ieee123' has none that acts; leave it out"):
        make_scenario("ieee123", **given)


def test_settings_of_capacitors_are_an_object_too():
    settings = CapacitorControl(measures="kvar")
    assert ieee13().replace(grid_control={"capacitor_settings": settings}).grid_control.capacitor_settings is settings


def fixed_in(feeder, *banks):
    """The feeder with regulators of some banks at fixed taps."""
    table = feeder.network.regulator
    most = tuple(0 if bank in banks else 16 for bank in table.bank)
    return ThreePhaseFeeder.from_network(
        replace(feeder.network, regulator=replace(table, max_taps_per_move=most), name=feeder.name)
    )


@pytest.mark.parametrize("mode", ["controlled", "agent", "setpoint"])
def test_a_fixed_tap_stays_fixed_in_every_mode(mode):
    scenario = ieee123().replace(
        feeder=fixed_in(ieee123().feeder, "reg1a", "reg3"), **{"grid_control.regulators": mode}
    )
    feeder = scenario.feeder
    deciders = regulator_deciders(scenario.grid_control, feeder)
    deciders = dict(zip(feeder.network.regulator.bank, deciders, strict=True))
    assert deciders == {"reg1a": "fixed", "reg2": mode, "reg3": "fixed", "reg4": mode}
    agents = {"controlled": 0, "agent": 4, "setpoint": 2}[mode]
    assert sum(name.startswith("reg") for name in scenario.agents) == agents


def test_a_mode_that_a_fixed_tap_cannot_have_is_refused_by_name():
    feeder = fixed_in(ieee123().feeder, "reg1a")
    with pytest.raises(
        ScenarioError, match="the taps of reg1a are fixed in feeder 'ieee123-3ph'; leave it out, or give"
    ):
        ieee123().replace(feeder=feeder, **{"grid_control.regulators": {"reg1a": "agent", "reg2": "agent"}})
    rigid = fixed_in(ieee123().feeder, "reg1a", "reg2", "reg3", "reg4")
    with pytest.raises(ScenarioError, match="the taps of reg1a, reg2, reg3, reg4 are fixed"):
        ieee123().replace(feeder=rigid, **{"grid_control.regulators": "setpoint"})
    assert acting_relays(ieee123().replace(feeder=rigid)) is None


@pytest.mark.parametrize("mode", ["controlled", "agent", "setpoint"])
def test_a_fixed_capacitor_bank_stays_fixed_in_every_mode(mode):
    feeder = ieee123().feeder
    table = feeder.network.capacitor
    first = tuple(int(name == "c83") for name in table.name)
    made = ThreePhaseFeeder.from_network(replace(feeder.network, capacitor=replace(table, is_fixed=first)))
    scenario = ieee123().replace(feeder=made, **{"grid_control.capacitors": mode})
    modes = dict(zip(table.name, capacitor_deciders(scenario.grid_control, made), strict=True))
    assert modes == {name: "fixed" if name == "c83" else mode for name in table.name}
    with pytest.raises(ScenarioError, match=r"the states of c83 are fixed in feeder .* or give is_fixed = 0 in its"):
        ieee123().replace(feeder=made, **{"grid_control.capacitors": {"c83": mode}})
    with pytest.raises(FeederError, match=r"is_fixed is 2.*give 1 if it stays in its state, or 0"):
        ThreePhaseFeeder.from_network(replace(feeder.network, capacitor=replace(table, is_fixed=(2, 0, 0, 0))))
    every = ThreePhaseFeeder.from_network(replace(feeder.network, capacitor=replace(table, is_fixed=(0,) * 4)))
    assert scenario_hash(ieee123().replace(feeder=feeder)) != scenario_hash(ieee123().replace(feeder=made))
    assert set(capacitor_deciders(scenario.grid_control, every)) == {mode}

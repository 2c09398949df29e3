"""Tuned parameters: those that ship, those of a file, and whose they are."""

import json

import pytest

from dcgrid_env import PRESETS, CostWeights, PrefillDecodeDvfs, load_feeder, make_scenario, scenario_hash
from dcgrid_env.baselines import Droop, make_controller
from dcgrid_env.baselines.tuning.tuned import GRID, USER_FILE, grid_difference, grid_hash, identity, tuned_parameters
from helpers.three_phase import ieee13, ieee34


@pytest.fixture(autouse=True)
def _elsewhere(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)


def write(path, law, name, gain, scenario=None, law_is_of=None):
    """A file of tuned parameters with one entry."""
    path.parent.mkdir(parents=True, exist_ok=True)
    entry = {"parameters": {"k_q_mvar_per_pu_s": gain}}
    path.write_text(json.dumps({"laws": {law: {name: entry | (identity(scenario) if scenario else {})}}}))


@pytest.mark.parametrize(
    ("field", "overrides"),
    [
        (
            "feeder",
            {"feeder": load_feeder("das69"), "datacenters.buses": (27, 65, 35), "inverters.buses": (5, 12, 40, 61)},
        ),
        ("source_voltage_pu", {"source_voltage_pu": 1.0}),
        ("background.capacitors", {"background.capacitors": False}),
        ("datacenters.count", {"n_datacenters": 2, "datacenters.buses": (18, 33)}),
        ("datacenters.buses", {"datacenters.buses": (18, 33, 24)}),
        ("datacenters.p_rated_kw", {"datacenters.p_rated_kw": (1000.0, 1000.0, 900.0)}),
        ("datacenters.idle_share", {"datacenters.idle_share": 0.3}),
        ("datacenters.f_min_mhz", {"datacenters.f_min_mhz": 300.0}),
        ("datacenters.f_max_mhz", {"datacenters.f_max_mhz": 1500.0}),
        ("datacenters.s_rated_share", {"datacenters.s_rated_share": 1.1}),
        ("datacenters.q_max_share", {"datacenters.q_max_share": 0.3}),
        ("datacenters.clock_law", {"datacenters.clock_law": PrefillDecodeDvfs()}),
        ("datacenters.boost_share", {"datacenters.boost_share": 1.3}),
        ("inverters.buses", {"inverters.buses": (7, 14, 20, 29)}),
        ("inverters.s_rated_kva", {"inverters.s_rated_kva": 101.0}),
        ("dt_s", {"dt_s": 0.5}),
    ],
)
def test_a_preset_whose_grid_differs_does_not_get_its_gains(field, overrides):
    assert field in GRID
    own = make_scenario("ieee33-weak", **overrides)
    with pytest.raises(
        ValueError, match=rf"from which this one differs in {field}; find its own with `dcgrid tune --laws"
    ):
        make_controller("droop-tuned", own)
    assert grid_hash(own) != grid_hash(make_scenario("ieee33-weak"))


def test_a_scenario_of_another_name_is_told_which_presets_gains_would_serve_it():
    own = make_scenario("ieee33-weak", name="weak-rural", horizon=20)
    said = "its grid is that of ieee33-weak and bursty, whose it takes with --set name=ieee33-weak; find its own with"
    with pytest.raises(ValueError, match=said):
        tuned_parameters("droop", own)
    with pytest.raises(ValueError, match=r"results/tuned.json; find its own"):
        tuned_parameters("droop", own.replace(source_voltage_pu=1.0))


@pytest.mark.parametrize(
    "overrides",
    [
        {"split": "test"},
        {"horizon": 30, "sensing.noise_pu": 0.01, "sensing.delay_steps": 2, "background.load_sigma": 0.1},
        {"observe": "feeder", "sensing.preview": False, "reward": "local", "weights": CostWeights(backlog=1.0)},
        {"trace": "code", "workload.site_correlation": 1.0, "sensing.r_model_share": 0.8, "power_flow": "lindistflow"},
        {
            "datacenters.p_rated_kw": (1000,) * 3,
            "inverters.s_rated_kva": (100, 100.0, 100.0, 100.0),
        },  # the same, written otherwise
    ],
)
def test_what_gains_do_not_depend_on_may_differ(overrides):
    own, preset = make_scenario("ieee33-weak", **overrides), make_scenario("ieee33-weak")
    assert tuned_parameters("droop", own) == tuned_parameters("droop", preset)
    assert tuned_parameters("droop", own).file is None
    assert grid_hash(own) == grid_hash(preset)


@pytest.mark.parametrize("name", PRESETS)
def test_every_preset_has_its_own(name):
    for split in ("train", "validation", "test"):
        assert tuned_parameters("droop", make_scenario(name, split=split)).parameters


def test_ones_own_are_found_in_results_and_in_a_file_that_is_named(tmp_path):
    own = make_scenario("ieee33-weak", name="mine", source_voltage_pu=1.0)
    with pytest.raises(ValueError, match=r"'droop' for scenario 'mine' ship with the package, nor stand in results"):
        make_controller("droop-tuned", own)
    write(USER_FILE, "droop", "mine", 3.0, own)
    write(tmp_path / "other.json", "droop", "mine", 4.0, own)
    for scenario in (own, own.replace(split="test"), own.replace(horizon=20)):
        found = tuned_parameters("droop", scenario)
        assert found == ({"k_q_mvar_per_pu_s": 3.0}, USER_FILE)
        law = make_controller("droop-tuned", scenario, tmp_path / "other.json")
        assert isinstance(law, Droop)
        assert law.k_q_mvar_per_pu_s == 4.0
    with pytest.raises(
        ValueError, match="has some of another 'mine', whose feeder, devices or step differ; find its own"
    ):
        make_controller("droop-tuned", own.replace(source_voltage_pu=1.02))
    with pytest.raises(
        ValueError, match=r"of 'droop-q' for scenario 'mine' stand in .*other\.json; find .* --out .*other"
    ):
        make_controller("droop-q-tuned", own, tmp_path / "other.json")
    with pytest.raises(ValueError, match=r"tuned is 'nowhere\.json', which is no file"):
        make_controller("droop-tuned", own, "nowhere.json")


def test_the_presets_own_gains_come_before_those_of_its_variants():
    preset = make_scenario("ieee33-weak")
    shipped = tuned_parameters("droop", preset)
    write(USER_FILE, "droop", "ieee33-weak", 3.0, preset.replace(horizon=60))
    assert tuned_parameters("droop", preset) == shipped
    assert tuned_parameters("droop", preset.replace(horizon=50)) == shipped
    assert tuned_parameters("droop", preset.replace(horizon=60, split="test")).file == USER_FILE
    write(USER_FILE, "droop", "ieee33-weak", 3.0)  # of the preset itself: the scores stay those published ...
    assert tuned_parameters("droop", preset) == shipped
    assert tuned_parameters("droop", preset, USER_FILE).parameters == {"k_q_mvar_per_pu_s": 3.0}  # ... unless asked for
    with pytest.raises(ValueError, match="has some of another 'ieee33-weak'"):
        tuned_parameters("droop", preset.replace(source_voltage_pu=1.0), USER_FILE)


def test_the_hash_of_a_file_is_that_of_the_validation_split():
    own = make_scenario("toy6", split="test", horizon=30)
    assert identity(own)["scenario_hash"] == scenario_hash(make_scenario("toy6", split="validation", horizon=30))
    assert grid_difference(own, make_scenario("toy6")) is None


def test_a_damaged_file_is_named():
    USER_FILE.parent.mkdir()
    USER_FILE.write_text("{")
    with pytest.raises(
        ValueError,
        match=r"results/tuned\.json: is not JSON .*; pass a file that dcgrid tune wrote",
    ):
        make_controller("droop-tuned", make_scenario("toy6", name="mine"))


def test_a_three_phase_grid_is_told_from_another():
    base = ieee13()
    assert grid_difference(base, base.replace(horizon=7, trace="chat", weights={"unbalance": 3.0})) is None
    assert grid_difference(base, ieee34()) == "feeder"
    assert grid_hash(base) == grid_hash(base.replace(observe="feeder"))
    slow = {"regulators": "setpoint", "regulator_settings": {"timer": "reset", "offset_v": -2.0}}
    assert grid_hash(base) == grid_hash(base.replace(grid_control=slow))
    assert grid_hash(base) != grid_hash(base.replace(inverters={"phases": ("a", "abc", "c", "a")}))

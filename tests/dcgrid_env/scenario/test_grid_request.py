"""The part `grid_request`: plain forms, files, fingerprint and errors with a remedy."""

import json

import pytest

from dcgrid_env import GridRequest, LoadTarget, ScenarioError, make_scenario, scenario_hash
from dcgrid_env.scenario.grid_request import draw_range
from dcgrid_env.scenario.serialization import to_data

CAP = {"value_share": [0.3, 0.5], "begin_s": [20.0, 40.0], "ramp_s": 10.0, "duration_s": 60.0}


def test_a_number_is_a_range_without_width():
    target = LoadTarget(value_mw=1, begin_s=5, ramp_s=[1, 2], duration_s=(3, 4))  # pyright: ignore[reportArgumentType]
    assert target.value_mw == (1.0, 1.0)
    assert (target.begin_s, target.ramp_s, target.duration_s) == ((5.0, 5.0), (1.0, 2.0), (3.0, 4.0))
    assert (target.kind, target.priority, target.value_share) == ("cap", 0, None)


def test_forms_of_a_request_give_the_same_scenario(tmp_path):
    by_object = make_scenario("ieee33-weak", grid_request=GridRequest(targets=(LoadTarget(**CAP),), notice_s=30.0))
    by_mapping = make_scenario("ieee33-weak", grid_request={"targets": [CAP], "notice_s": 30.0})
    by_path = make_scenario("ieee33-weak", **{"grid_request.targets": CAP, "grid_request.notice_s": 30.0})
    file = tmp_path / "request.toml"
    by_object.to_toml(file)
    differences = tmp_path / "differences.toml"
    by_object.to_toml(differences, base=make_scenario("ieee33-weak"))
    assert "[[grid_request.targets]]" in differences.read_text()
    plain = json.loads(json.dumps(to_data(by_object.grid_request)))
    again = make_scenario("ieee33-weak", grid_request=plain)
    for other in (by_mapping, by_path, make_scenario(file), make_scenario(differences), again):
        assert by_object.grid_request == other.grid_request
        assert scenario_hash(by_object) == scenario_hash(other.replace(name=by_object.name))


def test_a_fingerprint_changes_with_every_field_of_a_request_and_not_without_one():
    plain = make_scenario("ieee33-weak")
    assert scenario_hash(plain.replace(grid_request=GridRequest())) == scenario_hash(plain)
    base = plain.replace(grid_request={"targets": [CAP]})
    others: list[dict[str, object]] = [
        {"kind": "target"}, {"value_share": 0.4}, {"begin_s": 0.0}, {"ramp_s": 0.0}, {"duration_s": 9.0},
        {"priority": 1}, {"value_share": None, "value_mw": 1.0},
    ]  # fmt: skip
    changed = [base.replace(grid_request={"targets": [CAP | other]}) for other in others]
    changed += [base.replace(grid_request={name: 0.5}) for name in ("notice_s", "tolerance_share")]
    assert len({scenario_hash(scenario) for scenario in (plain, base, *changed)}) == len(changed) + 2
    assert all(str(base.difference(scenario)).startswith("grid_request.") for scenario in changed)


@pytest.mark.parametrize(
    ("targets", "message"),
    [
        ([{"begin_s": 3.0}], r"targets\[0\].value_share is None; give value_share, .* or value_mw, and not both"),
        ([CAP | {"value_mw": 1}], r"targets\[0\].value_share is .*; give value_share, .* and not both"),
        ([CAP | {"kind": "floor"}], r"targets\[0\].kind is 'floor'; choose one of cap, target"),
        ([CAP, CAP | {"ramp_s": [5, 1]}], r"targets\[1\].ramp_s is \[5, 1\]; give the lowest first"),
        ([CAP | {"duration_s": 0}], r"targets\[0\].duration_s is .*; give a shortest above 0 s"),
        ([CAP | {"begin_s": -1}], r"targets\[0\].begin_s is -1; give a number from 0 to"),
        ([CAP | {"priority": 1.5}], r"targets\[0\].priority is 1.5; give a whole number"),
        ([CAP | {"share": 1}], r"grid_request.targets\[0\].share is no field; did you mean value_share"),
        (3, r"grid_request.targets is 3; give a list of LoadTarget"),
        ([CAP | {"value_share": 1.5}], r"targets\[0\].value_share is \(1.5, 1.5\); give at most 1, which"),
        ([{"value_mw": [1, 4]}], r"targets\[0\].value_mw is \(1.0, 4.0\); give at most 3 MW, which"),
    ],
)
def test_errors_of_a_request_name_field_value_and_remedy(targets, message):
    with pytest.raises(ScenarioError, match=message):
        make_scenario("ieee33-weak", grid_request={"targets": targets})


@pytest.mark.parametrize(
    ("overrides", "message"),
    [
        ({"grid_request.notice_s": -1.0}, r"grid_request.notice_s is -1.0; give a finite number in \[0, 1e\+09\]"),
        ({"weights": {"grid_request": 1.0}}, r"cost.weights.grid_request is 1.0; give grid_request.targets too"),
        (
            {"n_datacenters": 0, "datacenters.buses": None, "grid_request.targets": [CAP]},
            r"grid_request.targets is .*; leave it out: the scenario has no data centre",
        ),
    ],
)
def test_errors_of_the_part_name_field_value_and_remedy(overrides, message):
    with pytest.raises(ScenarioError, match=message):
        make_scenario("ieee33-weak", **overrides)


def test_what_sites_can_draw_bounds_a_request():
    assert draw_range(make_scenario("ieee33-weak")) == (0.0, 1.0)
    with_storage = make_scenario("ieee33-weak", **{"datacenters.storage": {"p_rated_kw": 300.0, "energy_kwh": 5.0}})
    assert draw_range(with_storage) == pytest.approx((with_storage.datacenters.largest_export_share * -1.0, 1.0))
    assert draw_range(with_storage)[0] < 0.0

"""Shunts, ratios and ratings of a balanced feeder: through tables and files and back, None for nothing, refusals."""

import dataclasses
import math
import re

import numpy as np
import pytest

from dcgrid_env import Feeder, FeederError, load_feeder

NAN = math.nan
GIVEN = {
    "shunt_kw": [0.0, 1.5, 0.0, 0.0, 0.25],
    "shunt_kvar": [3.0, 0.0, -2.5, 0.0, 0.0],
    "voltage_ratio": [1.0, NAN, 1.025, 0.9, 1.0],
    "bus_base_kv": [NAN, 10.0, 0.4, NAN, 20.0],
    "rating_a": [NAN, 120.0, 80.5, NAN],
}
FIELDS = tuple(GIVEN)


def made(**changes):
    """Buses a (the substation), c, d, b, e; branches out of order and some turned: c - b, b - a, b - d, a - e."""
    tables = {
        "name": "made", "base_kv": 10.0, "substation": "a", "v0_pu": 1.0, "bus_ids": list("acdbe"),
        "p_load_kw": [0.0, 1.0, -2.0, 3.0, 4.0], "q_load_kvar": [0.0] * 5, "from_bus": ["c", "b", "b", "a"],
        "to_bus": ["b", "a", "d", "e"], "r_ohm": [1.0, 2.0, 3.0, 4.0], "x_ohm": [1.0] * 4,
    }  # fmt: skip
    return Feeder.from_tables(**{**tables, **changes})


def assert_same(one, other):
    for field in dataclasses.fields(Feeder):
        a, b = getattr(one, field.name), getattr(other, field.name)
        if isinstance(a, np.ndarray):
            np.testing.assert_array_equal(a, b, strict=True)
        else:
            assert a == b, field.name


def test_each_field_follows_its_buses_and_branches():
    feeder = made(**GIVEN)
    assert feeder.bus_ids == ("a", "c", "d", "b", "e")
    own = {field: getattr(feeder, field).tolist() for field in FIELDS}
    assert own["shunt_kw"] == GIVEN["shunt_kw"]
    assert own["shunt_kvar"] == GIVEN["shunt_kvar"]
    assert own["voltage_ratio"] == [1.0, 1.0, 1.025, 0.9, 1.0]
    assert own["bus_base_kv"] == [10.0, 10.0, 0.4, 10.0, 20.0]
    by_bus = dict(zip(feeder.bus_ids[1:], own["rating_a"], strict=True))
    assert str(by_bus) == str({"c": NAN, "d": 80.5, "b": 120.0, "e": NAN})
    assert feeder.p_load_kw.tolist() == [0.0, 1.0, -2.0, 3.0, 4.0]
    assert all(not getattr(feeder, field).flags.writeable for field in FIELDS)


@pytest.mark.parametrize("fields", [FIELDS, *((field,) for field in FIELDS), ()])
def test_through_tables_and_files_and_back_to_the_bit(tmp_path, fields):
    feeder = made(**{field: GIVEN[field] for field in fields})
    assert [field for field in FIELDS if getattr(feeder, field) is not None] == list(fields)
    assert_same(Feeder.from_network(feeder.to_network()), feeder)
    feeder.to_csv(tmp_path)
    assert_same(Feeder.from_csv(tmp_path), feeder)
    header = (tmp_path / "buses.csv").read_text().splitlines()[0].split(",")
    assert header[:6] == ["bus", "p_kw", "q_kvar", "capacitor_kvar", "x", "y"]
    assert set(header[6:]) == {{"bus_base_kv": "base_kv"}.get(f, f) for f in fields} - {"rating_a"}


@pytest.mark.parametrize(
    ("field", "nothing"),
    [("shunt_kw", [0.0] * 5), ("shunt_kvar", [0.0] * 5), ("voltage_ratio", [1.0, NAN, 1.0, 1.0, NAN]),
     ("bus_base_kv", [10.0, NAN, 10.0, 10.0, NAN]), ("rating_a", [NAN] * 4)],
)  # fmt: skip
def test_a_column_of_nothing_is_none(field, nothing):
    assert getattr(made(**{field: nothing}), field) is None


def test_the_named_feeders_have_none_of_them():
    for name in ("toy6", "ieee33", "ieee123"):
        assert [getattr(load_feeder(name), field) for field in FIELDS] == [None] * 5


@pytest.mark.parametrize(("given", "said"), [
    ({"shunt_kw": [0.0, NAN, 0.0, 0.0, 0.0]}, "bus c: shunt_kw is nan; give a finite number"),
    ({"shunt_kvar": [0.0, math.inf, 0.0, 0.0, 0.0]}, "bus c: shunt_kvar is inf; give a finite number"),
    ({"voltage_ratio": [1.0, -1.0, 1.0, 1.0, 1.0]}, "bus c: voltage_ratio is -1.0; it must be > 0"),
    ({"voltage_ratio": [1.1, 1.0, 1.0, 1.0, 1.0]}, "bus a: voltage_ratio is 1.1, but it is the substation, .* give 1 "),
    ({"bus_base_kv": [20.0, 1.0, 1.0, 1.0, 1.0]}, "bus a: base_kv is 20.0, but it is the substation, .* give 10 "),
    ({"bus_base_kv": [10.0, 0.0, 1.0, 1.0, 1.0]}, "bus c: base_kv is 0.0; it must be > 0"),
    ({"rating_a": [0.0, 1.0, 1.0, 1.0]}, "branch c-b: rating_a is 0.0; it must be > 0"),
    ({"rating_a": [1.0]}, "1 values of rating_a for 4 branch rows"),
    ({"voltage_ratio": [1.0]}, "1 values of voltage_ratio for 5 bus rows"),
])  # fmt: skip
def test_what_cannot_be_is_refused_by_name(given, said):
    with pytest.raises(FeederError, match=said):
        made(**given)


@pytest.mark.parametrize(
    ("field", "values", "said"),
    [
        ("rating_a", -1.0, "branch to bus 2: rating_a is -1.0; give a number > 0"),
        ("rating_a", 0.0, "branch to bus 2: rating_a is 0.0; give a number > 0"),
        ("voltage_ratio", 0.0, "bus 1: voltage_ratio is 0.0; give a number > 0"),
        ("voltage_ratio", 1.1, "voltage_ratio of the substation is 1.1; it must be 1"),
        ("shunt_kvar", np.nan, "bus 1: shunt_kvar is nan; give a finite number"),
    ],
)
def test_a_field_that_is_replaced_is_checked_too(field, values, said):
    feeder = load_feeder("ieee33")
    n = feeder.n_branch if field == "rating_a" else feeder.n_bus
    with pytest.raises(FeederError, match=re.escape(said)):
        dataclasses.replace(feeder, **{field: np.full(n, values)})
    with pytest.raises(FeederError, match=re.escape(f"{field} has shape (3,); give one figure for each of {n}")):
        dataclasses.replace(feeder, **{field: np.ones(3)})

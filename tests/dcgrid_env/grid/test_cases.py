"""The named feeders against the figures that their sources print."""

import math
import tomllib
from importlib.resources import files

import numpy as np
import pytest

from dcgrid_env import FEEDERS, Feeder, FeederError, load_feeder
from helpers.feeders import BALANCED, THREE_PHASE
from helpers.places import SHARED_FEEDERS, require

# buses, kW and kvar in all, base kV, substation. ieee33 and ieee123 as their sources print the sums; das69 and khodr141
# as their published bus data add up.
PUBLISHED = {
    "toy6": (6, 600.0, 300.0, 1.0, 0),
    "ieee33": (33, 3715.0, 2300.0, 12.66, 1),
    "das69": (69, 3802.1, 2694.7, 12.66, 1),
    "ieee123": (123, 3490.0, 1920.0, 4.16, 114),
    "khodr141": (141, 11944.625, 7402.6137, 12.47, 1),
}


def test_every_named_feeder_is_checked_here_and_has_its_data():
    assert set(BALANCED) == set(PUBLISHED)
    assert {entry.name for entry in files("dcgrid_env.grid.data").iterdir() if (entry / "feeder.toml").is_file()} == (
        set(FEEDERS)
    )


@pytest.mark.parametrize("name", PUBLISHED)
def test_published_totals(name):
    n_bus, p_kw, q_kvar, base_kv, substation = PUBLISHED[name]
    feeder = load_feeder(name)
    assert feeder.name == name
    assert feeder.n_bus == len(feeder.bus_ids) == n_bus
    assert feeder.bus_ids[0] == str(substation)
    assert feeder.base_kv == base_kv
    assert feeder.v0_pu == 1.0
    assert feeder.p_load_kw.sum() == pytest.approx(p_kw, abs=1e-3)
    assert feeder.q_load_kvar.sum() == pytest.approx(q_kvar, abs=1e-3)
    assert all(array.shape == (n_bus,) for array in (feeder.p_load_kw, feeder.q_load_kvar, feeder.capacitor_kvar))
    assert all(array.shape == (n_bus - 1,) for array in (feeder.r_ohm, feeder.x_ohm, feeder.parent))


@pytest.mark.parametrize("name", FEEDERS)
def test_source_stands_with_the_data(name):
    head = tomllib.loads((files("dcgrid_env.grid.data") / name / "feeder.toml").read_text(encoding="utf-8"))
    assert len(head["source_of_facts" if name in THREE_PHASE else "source"].strip()) > 40


@pytest.mark.parametrize("name", BALANCED)
def test_shipped_data_are_the_published_data(name):
    published, shipped = Feeder.from_csv(require(SHARED_FEEDERS) / name), load_feeder(name)
    assert published.bus_ids == shipped.bus_ids
    assert (published.base_kv, published.v0_pu) == (shipped.base_kv, shipped.v0_pu)
    for field in ("p_load_kw", "q_load_kvar", "capacitor_kvar", "parent", "r_ohm", "x_ohm", "x", "y"):
        np.testing.assert_array_equal(getattr(published, field), getattr(shipped, field), strict=True)


def test_some_published_rows_of_ieee33():
    # Baran and Wu 1989, Table II: 17-18 and 29-30; the heaviest loads 24, 25, 30, 32.
    feeder = load_feeder("ieee33")
    at = feeder.index
    assert (feeder.r_ohm[at(18) - 1], feeder.x_ohm[at(18) - 1]) == (0.732, 0.574)
    assert feeder.bus_ids[feeder.parent[at(18) - 1]] == "17"
    assert [feeder.bus_ids[feeder.parent[at(bus) - 1]] for bus in (19, 23, 26)] == ["2", "3", "6"]
    assert [feeder.p_load_kw[at(bus)] for bus in (24, 25, 30, 32)] == [420.0, 420.0, 200.0, 210.0]
    assert feeder.q_load_kvar[at(30)] == 600.0


def test_capacitors_of_ieee123_and_of_no_other():
    feeder = load_feeder("ieee123")
    assert {bus: c for bus, c in zip(feeder.bus_ids, feeder.capacitor_kvar, strict=True) if c} == {
        "83": 600.0, "88": 50.0, "90": 50.0, "92": 50.0,
    }  # fmt: skip
    assert not any(load_feeder(name).capacitor_kvar.any() for name in BALANCED if name != "ieee123")


def test_closed_switches_of_ieee123_are_exactly_zero():
    feeder = load_feeder("ieee123")
    switches = [k for k in range(feeder.n_bus - 1) if feeder.r_ohm[k] == 0.0 and feeder.x_ohm[k] == 0.0]
    ends = {frozenset((feeder.bus_ids[feeder.parent[k]], feeder.bus_ids[k + 1])) for k in switches}
    assert ends == {frozenset(pair.split()) for pair in ("114 149", "13 152", "18 135", "60 160", "97 197")}
    assert not feeder.r_pu[switches].any()
    assert not feeder.x_pu[switches].any()


def test_loads_of_khodr141_have_its_power_factor():
    feeder = load_feeder("khodr141")
    np.testing.assert_allclose(feeder.q_load_kvar, feeder.p_load_kw * math.tan(math.acos(0.85)), rtol=1e-8)


def test_the_one_branch_of_khodr141_without_resistance_keeps_its_reactance():
    feeder = load_feeder("khodr141")
    k = feeder.index(87) - 1
    assert feeder.bus_ids[feeder.parent[k]] == "86"
    assert (feeder.r_ohm[k], feeder.x_ohm[k]) == (0.0, 1e-5)


def test_coordinates():
    ieee123, toy6 = load_feeder("ieee123"), load_feeder("toy6")
    assert (ieee123.x[ieee123.index(1)], ieee123.y[ieee123.index(1)]) == (700.0, 1500.0)
    assert (ieee123.x[ieee123.index(450)], ieee123.y[ieee123.index(450)]) == (5450.0, 2100.0)
    assert np.isfinite(ieee123.x).all()
    assert np.isfinite(ieee123.y).all()
    assert toy6.y.tolist() == [0.0, 0.0, 0.5, -0.5, 1.5, 1.5]
    assert np.isnan(load_feeder("ieee33").x).all()


def test_the_same_object_at_each_call():
    assert load_feeder("ieee33") is load_feeder("ieee33")


@pytest.mark.parametrize("name", ["ieee34", "", "../toy6", "data"])
def test_an_unknown_name_says_where_all_are_listed(name):
    with pytest.raises(FeederError, match=rf"no feeder '{name}'; .*`dcgrid list feeders` lists all; your own"):
        load_feeder(name)

"""Figures of a size that no feeder has are refused with component, field and value."""

import re

import pytest

from dcgrid_env import Feeder, FeederError, ScenarioError, make_scenario

HEAD = 'name = "f"\nbase_kv = {}\nsubstation = "1"\nv0_pu = {}\n'
BUSES = "bus,p_kw,q_kvar,capacitor_kvar\n1,0,0,0\n2,{},{},{}\n"
BRANCHES = "from_bus,to_bus,r_ohm,x_ohm,rating_a\n1,2,{},{},{}\n"
SOUND = {"base_kv": 10, "v0_pu": 1, "p_kw": 100, "q_kvar": 30, "capacitor_kvar": 0}
SOUND |= {"r_ohm": 0.1, "x_ohm": 0.2, "rating_a": 300}


def feeder(folder, **changed):
    """A feeder of two buses from a folder with some figures changed."""
    cells = [*(SOUND | changed).values()]
    (folder / "feeder.toml").write_text(HEAD.format(*cells[:2]))
    (folder / "buses.csv").write_text(BUSES.format(*cells[2:5]))
    (folder / "branches.csv").write_text(BRANCHES.format(*cells[5:]))
    return Feeder.from_csv(folder)


@pytest.mark.parametrize("field", SOUND)
def test_a_feeder_refuses_what_no_feeder_has(field, tmp_path):
    assert feeder(tmp_path).n_bus == 2
    for value in ("1e300", "1e13", "1e-300", "1e-320"):
        with pytest.raises(
            FeederError, match=rf"{field}.* is {re.escape(str(float(value)))}; .*(unit|at least 1e-100)"
        ):
            feeder(tmp_path, **{field: value})


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("datacenters.p_rated_kw", 1e300),
        ("datacenters.p_rated_kw", 1e-300),
        ("datacenters.s_rated_share", 1e300),
        ("datacenters.f_max_mhz", 1e300),
        ("inverters.s_rated_kva", 1e-300),
        ("source_voltage_pu", 1e300),
        ("weights", {"voltage": 1e300}),
        ("dt_s", 1e-300),
    ],
)
def test_a_scenario_refuses_them_too(field, value):
    with pytest.raises(ScenarioError, match=rf"{field}(\.voltage)? is 1e[+-]300; give"):
        make_scenario("toy6", **{field: value})

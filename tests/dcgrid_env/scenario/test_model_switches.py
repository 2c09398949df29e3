"""The model of agents and controllers with other switches: order of buses, sensitivities, files and refusals."""

from itertools import pairwise

import numpy as np
import pytest

from dcgrid_env import (
    believed_sensitivity,
    make_scenario,
    scenario_hash,
    sensitivity_to_agents,
)
from dcgrid_env.baselines.model_aided.commissioning import site_of
from dcgrid_env.baselines.model_aided.moment_flow import MomentFlow
from dcgrid_env.engine.physics.connections import between_agents, own_distance
from dcgrid_env.scenario.errors import ScenarioError

OPEN, TIE = (("6", "7"),), (("12", "22", 2.0, 2.0),)
"""Buses 7 to 18 are fed from 22 through 12, so that buses 12 to 7 follow each other in the other direction."""


def switched(**sensing):
    return make_scenario("ieee33", sensing={"model_open": OPEN, "model_closed": TIE, **sensing})


def test_sensitivities_follow_the_paths_of_the_model():
    s = switched()
    feeder, ohm = s.feeder, {}
    for k, name in enumerate(feeder.branch_names):
        ohm[frozenset(name.removeprefix("branch ").split("-"))] = feeder.r_ohm[k]
    ohm[frozenset(("12", "22"))] = 2.0

    def resistance(*buses):
        return sum(ohm[frozenset(pair)] for pair in pairwise(buses)) / feeder.base_kv**2

    to_9 = ("1", "2", "19", "20", "21", "22", "12", "11", "10", "9")
    r = believed_sensitivity(s).by_p_pu_per_mw
    at_9, at_18, at_6 = (feeder.index(bus) for bus in ("9", "18", "6"))
    assert r[at_9, at_9] == pytest.approx(resistance(*to_9))
    assert r[at_9, at_18] == pytest.approx(resistance(*to_9[:7]))
    assert r[at_9, at_6] == pytest.approx(resistance("1", "2"))
    buses = np.array([[at_9, at_18] + [at_6] * (s.n_agents - 2)])
    np.testing.assert_allclose(sensitivity_to_agents(s, buses).by_p_pu_per_mw[0, 0], r[at_9])
    np.testing.assert_allclose(own_distance(s)[0, :, 0], np.diag(r))
    x = believed_sensitivity(s).by_q_pu_per_mvar
    apart = [m[at_9, at_9] + m[at_18, at_18] - 2.0 * m[at_9, at_18] for m in (r, x)]
    assert between_agents(s, buses)[0, 0, 1] == pytest.approx(np.hypot(*apart))


def test_voltages_at_commissioning_follow_the_switches_of_the_model():
    agents = (18, 33, 25, 22, 3, 7, 14, 20, 24, 30)
    flow = MomentFlow(site_of(switched()), np.array([switched().feeder.index(bus) for bus in agents]))
    q_kvar = np.zeros((len(flow.points.p_load_kw), flow.scenario.n_agents))
    v = flow.voltages(q_kvar)
    at = {bus: flow.scenario.feeder.index(bus) - 1 for bus in ("7", "12", "22", "6")}
    # Bus 7 ends the path 22, 12, .., 7, and 6 has lost its load beyond.
    assert (v[:, at["7"]] < v[:, at["12"]]).all()
    assert (v[:, at["12"]] < v[:, at["22"]]).all()
    assert (v[:, at["6"]] > v[:, at["7"]]).all()


def test_the_grid_itself_has_its_own_switches():
    true, wrong = make_scenario("ieee33"), switched()
    assert wrong.feeder is true.feeder
    assert wrong.model is not wrong.feeder
    assert true.model is true.feeder
    assert scenario_hash(wrong) != scenario_hash(true)
    assert scenario_hash(switched(model_open=(), model_closed=())) == scenario_hash(true)


def plain_arrays():
    """The switches of ``switched`` as NumPy values."""
    return {"model_open": np.array([[6, 7]]), "model_closed": [[np.int64(12), "22", np.float64(2.0), np.int64(2)]]}


def test_plain_forms_and_files(tmp_path):
    plain = make_scenario("ieee33", sensing={"model_open": [[6, 7]], "model_closed": [[12, "22", 2.0, 2]]})
    assert plain.sensing == switched().sensing
    assert make_scenario("ieee33", sensing=plain_arrays()).sensing == plain.sensing
    plain.to_toml(tmp_path / "wrong.toml", make_scenario("ieee33"))
    assert make_scenario(tmp_path / "wrong.toml").sensing == plain.sensing


@pytest.mark.parametrize(
    ("scenario", "sensing", "message"),
    [
        ("ieee33", {"model_open": [["6"]]}, r"sensing.model_open is \(\('6',\),\); give a list of branches"),
        ("ieee33", {"model_closed": [["12", "22", -1.0, 2.0]]}, "sensing.model_closed is .*of 0 to 10000 ohm"),
        ("ieee33", {"model_closed": [["12", "22", 1e308, 2.0]]}, "sensing.model_closed is .*of 0 to 10000 ohm"),
        ("ieee33", {"model_open": [["6", "9"]]}, "sensing.model_open is .*no branch 6-9 to open"),
        ("ieee33", {"model_open": [["6", "7"]]}, "sensing.model_open is .*the model is no feeder"),
        ("ieee33", {"model_closed": [["12", "99", 2.0, 2.0]]}, "sensing.model_closed is .*no bus '99'"),
        ("zero-shot", {"model_open": [["6", "7"]]}, "sensing.model_open is .*leave it out"),
        ("ieee13-3ph", {"model_open": [["650", "632"]]}, "sensing.model_open is .*leave it out"),
    ],
)
def test_refusals(scenario, sensing, message):
    with pytest.raises(ScenarioError, match=message):
        make_scenario(scenario, sensing=sensing)

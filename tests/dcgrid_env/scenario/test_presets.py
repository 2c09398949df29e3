"""The named scenarios. Hashes in tests/golden keep every constant of theirs."""

import math

import numpy as np
import pytest

from dcgrid_env import (
    IDS,
    PRESETS,
    FeederError,
    Scenario,
    ScenarioError,
    action_layout,
    field_names,
    forecast,
    load_feeder,
    make_scenario,
)
from dcgrid_env.baselines import NoControl, rollout
from dcgrid_env.engine.family_simulation import simulation as simulation_of
from dcgrid_env.engine.simulation import Simulation
from dcgrid_env.scenario.preset_table import TABLE
from helpers.intervals import interval


def test_every_preset_has_a_description_an_id_and_a_base_that_exists():
    assert all(PRESETS.values())
    assert sorted(IDS.values()) == sorted(PRESETS)
    assert {preset.base for preset in TABLE} <= {None, *PRESETS}


def test_a_preset_on_a_base_has_its_fields_and_those_of_the_base():
    s = make_scenario("ieee33")
    assert (s.name, s.feeder, s.source_voltage_pu) == ("ieee33", load_feeder("ieee33"), 1.05)
    np.testing.assert_allclose(s.datacenters.parameters.p_rated_kw, [600.0] * 4)
    np.testing.assert_allclose(s.datacenters.parameters.p_idle_kw, [0.23 * 600.0] * 4)
    np.testing.assert_allclose(s.datacenters.parameters.s_rated_kva, [1.02 * 600.0] * 4)
    np.testing.assert_allclose(s.datacenters.parameters.q_max_kvar, [0.33 * 600.0] * 4)
    np.testing.assert_allclose(s.inverters.parameters.s_rated_kva, [500.0] * 6)
    ups = make_scenario("ieee33-weak-ups")
    assert ups.devices[:2] == make_scenario("bursty").devices  # its list repeats them


@pytest.mark.slow
def test_in_sync_all_sites_draw_alike_and_with_pv_more_load_helps_at_noon():
    known = forecast(make_scenario("sync", split="test"), 0)
    np.testing.assert_array_equal(known.p_ref_kw, known.p_ref_kw[:, :1] * np.ones(4))
    # Under PV the mean voltage is above 1 p.u., and a site's load brings it nearer.
    calm = make_scenario("mixed", split="test")
    apart = [
        rollout(scenario, NoControl(), range(20)).costs().mean()
        for scenario in (
            calm,
            calm.replace(datacenters={"p_rated_kw": 400.0}),
            calm.replace(inverters={"injection": None}),
        )
    ]
    assert apart[0] < apart[1]  # a third less load, a higher cost
    assert apart[2] < apart[0]  # without PV there is less to do


def test_what_controllers_know_of_a_robust_feeder_is_wrong():
    s = make_scenario("robust")
    np.testing.assert_allclose(s.model.r_ohm, 0.8 * s.feeder.r_ohm)
    np.testing.assert_allclose(s.model.x_ohm, 1.2 * s.feeder.x_ohm)
    assert make_scenario("ieee33").model is s.feeder
    true, believed = (make_scenario(name) for name in ("ieee33", "robust"))
    one, two = (Simulation(x, 1).reset([0]).observation[0] for x in (true, believed))
    at = [i for i, name in enumerate(field_names(true)["dc_0"]) if name in ("r", "x")]
    np.testing.assert_allclose(two[at], one[at] * [0.8, 1.2], rtol=1e-6)


def test_ieee123_is_regulated_and_compensated():
    s = make_scenario("ieee123")
    assert s.source_voltage_pu == 1.0 + 7 * 0.00625  # tap +7 of a regulator of 32 steps over 10 %
    assert s.feeder.capacitor_kvar.sum() > 0
    assert s.feeder.n_bus == 123
    # 1 to 5 sites by option.
    for n in range(1, 6):
        assert make_scenario("ieee123", n_datacenters=n).n_agents == n + 7


def test_ieee33_weak_loses_the_band_at_peak_and_reactive_power_alone_cannot_keep_it():
    # Voltages under full sites: no control, all the reactive power there is, and the lowest clocks with it.
    from dcgrid_env.engine.exogenous import episode
    from dcgrid_env.engine.physics import dynamics

    s = make_scenario("ieee33-weak", background={"load_sigma": 0.0})
    zero = np.zeros(1, np.uint64)
    drawn = episode.draw(s, zero, zero)
    outside, _ = interval(s, drawn, np.zeros(1, int), np.zeros((1, 33)), np.full((1, 3), 1000.0))
    start, grid = dynamics.initial_state(s, outside)
    assert grid.solution.converged.all()
    lowest = {
        name: float(dynamics.step(s, start, np.array([[clock, q] * 3 + [q] * 4]), outside)[0].v_pu.min())
        for name, clock, q in (("nothing", 1.0, 0.0), ("reactive", 1.0, 1.0), ("both", -1.0, 1.0))
    }
    assert lowest["nothing"] < lowest["reactive"] < 0.95 < lowest["both"]


@pytest.mark.parametrize("name", PRESETS)
def test_every_preset_and_split_plays(name):
    for split in ("train", "validation", "test"):
        simulation = simulation_of(make_scenario(name, split=split, horizon=3), 2)
        simulation.reset([0, 1])
        n = len(action_layout(simulation.scenario).names)
        transition = [simulation.step(np.zeros((2, n))) for _ in range(3)][-1]
        assert transition.truncated.all()
        assert np.isfinite(transition.reward).all()


def test_overrides_reach_the_scenario_and_leave_the_preset():
    s = make_scenario(
        "toy6",
        horizon=5,
        feeder="ieee33",
        datacenters={"buses": (18,)},
        inverters={"buses": (7, 14)},
        source_voltage_pu=1.05,
    )
    assert s.horizon == 5
    assert s.feeder is load_feeder("ieee33")
    assert make_scenario("toy6").horizon == 100
    assert make_scenario("toy6").feeder.name == "toy6"


def test_a_scenario_is_taken_as_it_is():
    s = make_scenario("toy6")
    assert make_scenario(s) is s
    assert make_scenario(s, horizon=9).horizon == 9
    assert make_scenario(s, horizon=9).name == "toy6"


@pytest.mark.parametrize(
    ("name", "near"),
    [("ieee321", r"did you mean ieee33 or ieee123\? "), ("", ""), ("IEEE123", "did you mean ieee123, .*")],
)
def test_an_unknown_scenario_gets_suggestions(name, near):
    with pytest.raises(ScenarioError, match=rf"^no scenario '{name}'; {near}`dcgrid list scenarios` lists all$"):
        make_scenario(name)


def test_what_is_no_scenario_is_refused():
    wrong: object = ["toy6"]
    with pytest.raises(ScenarioError, match=r"scenario is \['toy6'\]; give a name \(toy6.*or a Scenario"):
        make_scenario(wrong)  # type: ignore[arg-type]


def test_an_unknown_override_gets_a_suggestion():
    with pytest.raises(TypeError, match=r"^no scenario field 'n_data_centers'; did you mean n_datacenters"):
        make_scenario("ieee123", n_data_centers=3)


def test_an_unknown_feeder_gets_suggestions():
    with pytest.raises(FeederError, match=r"^no feeder 'ieee34'; did you mean ieee33, "):
        make_scenario("toy6", feeder="ieee34")


@pytest.mark.parametrize("name", PRESETS)
def test_presets_are_made_anew_but_alike(name):
    one, two = make_scenario(name), make_scenario(name)
    assert isinstance(one, Scenario)
    assert one.feeder is two.feeder
    assert one.agents == two.agents
    assert math.isfinite(one.source_voltage_pu)

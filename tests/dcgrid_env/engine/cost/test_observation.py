"""What agents observe: fields in order, in their units and bounds, and no more than the scenario lets them."""

import math
from typing import Any

import numpy as np
import pytest
import torch

from dcgrid_env import CostWeights, Feeder, PrefillDecodeDvfs, Scenario, field_names, make_scenario
from dcgrid_env.devices import Work
from dcgrid_env.engine.cost import observation
from dcgrid_env.engine.exogenous import episode
from dcgrid_env.engine.physics import connections
from dcgrid_env.engine.physics.connections import Placement
from dcgrid_env.engine.simulation import Simulation, Transition
from helpers.forms import FORMS, WORK_CLASSES
from helpers.states import fields_of, state_of, with_fields

COMMON = ("v_deviation", "v_change", "p", "q", "q_limit", "r", "x")
SITE = (*COMMON, "p_ref_next", "backlog")
LAWS: dict[str, dict[str, Any]] = {
    "linear": {},
    "work_classes": WORK_CLASSES,
}
TWO_CLASSES = (*SITE, "p_ref_next_compute", "backlog_compute")


def named(scenario: Scenario, joint: np.ndarray) -> dict[str, dict[str, np.ndarray]]:
    """The joint observation (row, n_observation) by agent and field, (row,) each."""
    found: dict[str, dict[str, np.ndarray]] = {}
    at = 0
    for agent, names in field_names(scenario).items():
        found[agent] = {name: joint[:, at + i] for i, name in enumerate(names)}
        at += len(names)
    assert at == joint.shape[1]
    return found


def play(scenario: Scenario, n_env: int, steps: int, seed: int = 0, first_seed: int = 0) -> tuple[Simulation, Any]:
    """A simulation and an iterator over its transitions under random actions, the reset's first."""
    simulation = Simulation(scenario, n_env)
    rng = np.random.default_rng(seed)

    def transitions() -> Any:
        yield simulation.reset(range(first_seed, first_seed + n_env))
        for _ in range(steps):
            action = rng.uniform(-1, 1, (n_env, 2 * scenario.datacenters.count + scenario.inverters.count))
            yield simulation.step(action)

    return simulation, transitions()


# --- fields ----------------------------------------------------------------------------------------


def test_fields_and_their_order():
    assert field_names(make_scenario("toy6")) == {"dc_0": SITE, "inv_0": COMMON, "inv_1": COMMON}
    neighbours = tuple(f"neighbour{i}_{name}" for i in range(3) for name in ("v_deviation", "p", "q"))
    names = field_names(make_scenario("ieee33-weak", observe="neighbours"))
    assert list(names) == ["dc_0", "dc_1", "dc_2", "inv_0", "inv_1", "inv_2", "inv_3"]
    assert names["dc_2"] == (*SITE, *neighbours)
    assert names["inv_3"] == (*COMMON, *neighbours)
    # Fewer than three others: as many as there are.
    assert field_names(make_scenario("toy6", observe="neighbours"))["inv_1"] == (*COMMON, *neighbours[:6])
    buses = tuple(f"v_deviation_{bus}" for bus in (1, 2, 3, 4, 5))
    assert field_names(make_scenario("toy6", observe="feeder"))["dc_0"] == (*SITE, *buses)
    assert len(field_names(make_scenario("ieee123", observe="feeder"))["inv_0"]) == 7 + 122


def test_two_classes_add_their_fields_after_the_backlog():
    names = field_names(
        make_scenario("ieee33-weak", datacenters={"clock_law": PrefillDecodeDvfs()}, observe="neighbours")
    )
    assert names["dc_1"][:11] == TWO_CLASSES
    assert names["dc_1"][11] == "neighbour0_v_deviation"
    assert names["inv_0"][:8] == (*COMMON, "neighbour0_v_deviation")


def test_a_boost_widens_what_it_may_exceed():
    plain, wide = (
        make_scenario("toy6", horizon=30, datacenters={"clock_law": PrefillDecodeDvfs(), "boost_share": b})
        for b in (1.0, 1.3)
    )
    (low, high), (low_wide, high_wide) = (observation.bounds(s)["dc_0"] for s in (plain, wide))
    np.testing.assert_array_equal(low, low_wide)
    grown = {name for name, a, b in zip(TWO_CLASSES, high, high_wide, strict=True) if b != a}
    assert grown == {"p", "p_ref_next", "backlog", "p_ref_next_compute", "backlog_compute"}
    assert dict(zip(TWO_CLASSES, high_wide.tolist(), strict=True))["backlog"] == pytest.approx(39.0)


def test_bounds_of_the_fields():
    scenario = make_scenario("toy6", horizon=30, dt_s=2.0, cost={"band_pu": 0.04})
    low, high = observation.bounds(scenario)["dc_0"]
    assert low.dtype == high.dtype == np.float32
    assert dict(zip(SITE, low.tolist(), strict=True)) == {
        "v_deviation": -25, "v_change": -25, "p": -1, "q": -1, "q_limit": 0, "r": 0, "x": 0, "p_ref_next": 0,
        "backlog": 0,
    }  # fmt: skip
    # toy6's largest R_ii and X_ii are those of two branches in a row: 0.02 and 0.04 p.u. a MW, in bands of 0.04.
    assert dict(zip(SITE, high.tolist(), strict=True)) == {
        "v_deviation": 25, "v_change": 25, "p": 1, "q": 1, "q_limit": 1, "r": 0.5, "x": 1.0, "p_ref_next": 1,
        "backlog": 60,
    }  # fmt: skip
    wide = make_scenario("toy6", observe="neighbours")
    low, high = observation.bounds(wide)["inv_0"]
    assert low[7:].tolist() == [-20, -1, -1] * 2
    assert high[7:].tolist() == [20, 1, 1] * 2
    low, high = observation.bounds(make_scenario("toy6", observe="feeder"))["inv_0"]
    assert low[7:].tolist() == [-20] * 5
    assert high[7:].tolist() == [20] * 5
    joint_low, joint_high = observation.joint_bounds(scenario)
    parts = observation.bounds(scenario).values()
    np.testing.assert_array_equal(joint_low, np.concatenate([p[0] for p in parts]))
    np.testing.assert_array_equal(joint_high, np.concatenate([p[1] for p in parts]))


def test_without_a_band_voltages_are_in_per_unit():
    nothing_outside = CostWeights(violation=0.0)
    scenario = make_scenario("toy6", cost={"band_pu": 0.0}, weights=nothing_outside, observe="neighbours")
    low, high = observation.bounds(scenario)["dc_0"]
    assert (low[0], high[0], low[1], high[1]) == (-1.0, 1.0, -1.0, 1.0)
    for scope in ("neighbours", "feeder"):
        found = toy6_observed(
            **{"cost.band_pu": 0.0, "weights": nothing_outside, "observe": scope},
            **({} if scope == "neighbours" else {"measured": hand_made()["state"].v_pu}),
        )
        assert found["dc_0"]["v_deviation"] == pytest.approx(0.02)
        assert (found["inv_0"]["r"], found["inv_0"]["x"]) == pytest.approx((0.02, 0.04))
        other = "neighbour0_v_deviation" if scope == "neighbours" else "v_deviation_5"
        assert found["dc_0"][other] == pytest.approx(0.04)


def test_a_feeder_without_resistance_has_a_narrow_range_of_it():
    feeder = Feeder.from_tables(
        name="bare", base_kv=1.0, substation=0, v0_pu=1.0, bus_ids=[0, 1], p_load_kw=[0.0, 1.0],
        q_load_kvar=[0.0, 0.0], from_bus=[0], to_bus=[1], r_ohm=[0.0], x_ohm=[0.1],
    )  # fmt: skip
    scenario = make_scenario(
        "toy6", feeder=feeder, n_datacenters=0, datacenters={"buses": ()}, inverters={"buses": (1,)}
    )
    _, high = observation.bounds(scenario)["inv_0"]
    assert high[COMMON.index("r")] == np.float32(1e-6)
    assert high[COMMON.index("x")] == pytest.approx(0.1 / 0.05)


# --- figures worked by hand ------------------------------------------------------------------------


def hand_made(n_env: int = 1) -> dict[str, Any]:
    """toy6: the site of 2500 kW (q 825) at bus 4, inverters of 1000 kVA at buses 3 and 5."""
    values = {
        "v_pu": [1.0, 0.99, 0.98, 0.97, 1.02, 1.04],
        "v_last_pu": [1.0] * 6,
        "v_agent_pu": [1.02, 0.97, 1.04],
        "v_agent_last_pu": [1.01, 0.98, 1.04],
        "restart": [0.0] * 5,
        "backlog_kws": [5000.0],
        "class_backlog_kws": [5000.0],
        "class_arrived_kw": [0.0],
        "class_served_kw": [0.0],
        "f_mhz": [1410.0],
        "f_last_mhz": [1410.0],
        "arrived_kw": [0.0],
        "served_kw": [0.0],
        "p_kw": [1500.0, -250.0, 0.0],
        "q_kvar": [330.0, -100.0, 500.0],
        "q_limit_kvar": [825.0, 900.0, 1000.0],
    }
    state = state_of({name: np.array([row] * n_env) for name, row in values.items()})
    return {
        "state": state,
        "given_next": given(np.array([[2000.0]] * n_env)),
        "v_measured_pu": state.v_agent_pu,
        "v_before_pu": state.v_agent_last_pu,
    }


def given(p_ref_kw: Any, compute_share: Any = None) -> tuple[Work, None]:
    """Return the work of the next interval, and None for unknown injections."""
    return Work(p_ref_kw, compute_share), None


def placed_at(scenario: Scenario, buses: list[int], n_env: int = 1) -> Placement:
    return connections.placement(scenario, np.array([buses] * n_env))


def toy6_observed(measured: Any = None, **overrides: Any) -> dict[str, dict[str, float]]:
    """``measured``: every bus's voltage, where the feeder is observed."""
    scenario = make_scenario("toy6", **overrides)
    inputs = hand_made()
    if measured is not None:
        inputs |= {"v_measured_pu": measured, "v_before_pu": measured}
    joint = observation.observe(scenario, placed=placed_at(scenario, [4, 3, 5]), **inputs)
    return {agent: {k: float(v[0]) for k, v in own.items()} for agent, own in named(scenario, joint).items()}


# R_ii in p.u. a MW and X_ii a Mvar over the band: one branch of 0.01 + j0.02 to bus 4, two to buses 3 and 5.
WANTED = {
    "dc_0": {
        "v_deviation": 0.02 / 0.05, "v_change": 0.01 / 0.05, "p": 0.6, "q": 0.4, "q_limit": 1.0, "r": 0.2, "x": 0.4,
        "p_ref_next": 0.8, "backlog": 2.0,
    },
    "inv_0": {
        "v_deviation": -0.03 / 0.05, "v_change": -0.01 / 0.05, "p": -0.25, "q": -0.1, "q_limit": 0.9, "r": 0.4,
        "x": 0.8,
    },
    "inv_1": {"v_deviation": 0.04 / 0.05, "v_change": 0.0, "p": 0.0, "q": 0.5, "q_limit": 1.0, "r": 0.4, "x": 0.8},
}  # fmt: skip


def test_local_figures():
    found = toy6_observed()
    for agent, wanted in WANTED.items():
        assert found[agent] == pytest.approx(wanted, rel=1e-12, abs=1e-12)


def test_a_narrower_band_widens_the_voltages():
    found = toy6_observed(cost={"band_pu": 0.02})
    for agent, wanted in WANTED.items():
        for name in ("v_deviation", "v_change", "r", "x"):
            assert found[agent][name] == pytest.approx(2.5 * wanted[name], abs=1e-12)
        assert found[agent]["p"] == pytest.approx(wanted["p"])


def test_no_preview_hides_the_power_to_come():
    found = toy6_observed(sensing={"preview": False})
    for agent, wanted in WANTED.items():
        hidden = {"p_ref_next": 0.0} if agent == "dc_0" else {}
        assert found[agent] == pytest.approx({**wanted, **hidden}, abs=1e-12)
    scenario = make_scenario("toy6", sensing={"preview": False})
    inputs = hand_made()
    one = observation.observe(scenario, placed=placed_at(scenario, [4, 3, 5]), **inputs)
    inputs["given_next"] = given(np.array([[575.0]]))
    two = observation.observe(scenario, placed=placed_at(scenario, [4, 3, 5]), **inputs)
    np.testing.assert_array_equal(one, two)


@pytest.mark.parametrize("preview", [True, False])
def test_compute_bound_parts_of_what_comes_and_waits(preview):
    # 2000 kW less 575 idle, 0.4 of it compute-bound; 1500 of the 5000 kW s.
    scenario = make_scenario("toy6", datacenters={"clock_law": PrefillDecodeDvfs()}, sensing={"preview": preview})
    inputs = hand_made()
    inputs["state"] = with_fields(inputs["state"], class_backlog_kws=np.array([[[1500.0, 3500.0]]]))
    share = np.array([[0.4]])
    inputs["given_next"] = given(np.array([[2000.0]]), share)
    joint = observation.observe(scenario, placed=placed_at(scenario, [4, 3, 5]), **inputs)
    found = {k: float(v[0]) for k, v in named(scenario, joint)["dc_0"].items()}
    seen = {"p_ref_next": 0.8, "p_ref_next_compute": 0.4 * 1425.0 / 2500.0}
    seen = seen if preview else dict.fromkeys(seen, 0.0)
    assert found == pytest.approx({**WANTED["dc_0"], **seen, "backlog_compute": 0.6}, abs=1e-12)
    # Below the floor no work comes.
    inputs["given_next"] = given(np.array([[500.0]]), share)
    joint = observation.observe(scenario, placed=placed_at(scenario, [4, 3, 5]), **inputs)
    assert named(scenario, joint)["dc_0"]["p_ref_next_compute"].tolist() == [0.0]


def test_neighbours_are_the_electrically_nearest_in_turn():
    # Branches between them: site at 4 to 5 one, to 3 three; bus 3 to 5 four.
    found = toy6_observed(observe="neighbours")
    nearest = {"dc_0": ["inv_1", "inv_0"], "inv_0": ["dc_0", "inv_1"], "inv_1": ["dc_0", "inv_0"]}
    for agent, others in nearest.items():
        wanted = dict(WANTED[agent])
        for i, other in enumerate(others):
            wanted |= {f"neighbour{i}_{name}": WANTED[other][name] for name in ("v_deviation", "p", "q")}
        assert found[agent] == pytest.approx(wanted, abs=1e-12)


def test_feeder_scope_adds_every_bus_as_measured():
    scenario = make_scenario("toy6", observe="feeder")
    measured = [1.0, 0.98, 0.97, 0.96, 1.01, 1.03]
    before = [1.0, 0.99, 0.99, 0.99, 1.0, 1.0]
    inputs = hand_made()
    inputs["v_measured_pu"], inputs["v_before_pu"] = np.array([measured]), np.array([before])
    joint = observation.observe(scenario, placed=placed_at(scenario, [4, 3, 5]), **inputs)
    for (agent, found), bus in zip(named(scenario, joint).items(), (4, 3, 5), strict=True):
        own = {k: float(v[0]) for k, v in found.items()}
        seen = {
            "v_deviation": (measured[bus] - 1.0) / 0.05,
            "v_change": (measured[bus] - before[bus]) / 0.05,
            **{f"v_deviation_{b}": (v - 1.0) / 0.05 for b, v in enumerate(measured) if b},
        }
        assert own == pytest.approx({**WANTED[agent], **seen}, abs=1e-12)


def test_measured_voltages_are_what_an_agent_sees():
    scenario = make_scenario("toy6", observe="neighbours")
    inputs = hand_made()
    inputs["v_measured_pu"], inputs["v_before_pu"] = np.array([[0.9, 1.1, 1.0]]), np.array([[1.0, 1.0, 1.0]])
    joint = observation.observe(scenario, placed=placed_at(scenario, [4, 3, 5]), **inputs)
    found = named(scenario, joint)
    assert [float(found[a]["v_deviation"][0]) for a in found] == pytest.approx([-2.0, 2.0, 0.0])
    assert [float(found[a]["v_change"][0]) for a in found] == pytest.approx([-2.0, 2.0, 0.0])
    assert float(found["dc_0"]["neighbour1_v_deviation"][0]) == pytest.approx(2.0)


# --- placement -----------------------------------------------------------------------------------


def path_to_root(scenario: Scenario, bus: int) -> set[int]:
    """Branches between a bus and the substation, walked up the tree."""
    path = set()
    while bus:
        path.add(bus - 1)
        bus = int(scenario.feeder.parent[bus - 1])
    return path


@pytest.mark.parametrize("name", FORMS)
def test_distances_and_neighbours_walked_along_the_feeder(name):
    scenario = make_scenario(name, observe="neighbours")
    n_env, feeder = 5, scenario.feeder
    simulation = Simulation(scenario, n_env)
    simulation.reset(range(n_env))
    drawn = simulation.now.episode
    n, count = scenario.n_agents, min(3, scenario.n_agents - 1)
    # On 1 MVA, p.u. of impedance is p.u. of voltage for a MW.
    r_pu, x_pu = (z / feeder.base_kv**2 for z in (feeder.r_ohm, feeder.x_ohm))
    assert drawn.placed.nearest.shape == (n_env, n, count)
    for env_index in range(n_env):
        paths = [path_to_root(scenario, int(bus)) for bus in drawn.buses[env_index]]
        own = [[sum(z[k] for k in path) / 0.05 for path in paths] for z in (r_pu, x_pu)]
        np.testing.assert_allclose((drawn.placed.r[env_index], drawn.placed.x[env_index]), own, rtol=1e-9)
        for i in range(n):
            between = [math.hypot(*(sum(z[k] for k in paths[i] ^ paths[j]) for z in (r_pu, x_pu))) for j in range(n)]
            seen = drawn.placed.nearest[env_index, i] - env_index * n
            assert i not in seen
            assert len(set(seen.tolist())) == count
            found = [between[j] for j in seen]
            wanted = sorted(between[j] for j in range(n) if j != i)[:count]
            assert found == pytest.approx(wanted, rel=1e-9, abs=1e-12)  # nearest first


def test_an_agent_at_the_bus_of_another_is_no_neighbour_of_itself():
    scenario = make_scenario("toy6", observe="neighbours")
    nearest = placed_at(scenario, [3, 3, 5], n_env=2).nearest - 3 * np.arange(2)[:, None, None]
    assert nearest.tolist() == [[[1, 2], [0, 2], [0, 1]]] * 2


def test_neighbours_are_of_the_own_environment():
    scenario = make_scenario("ieee123", observe="neighbours")
    simulation, transitions = play(scenario, 4, 2)
    *_, last = transitions
    state, n = last.state, scenario.n_agents
    found = named(scenario, last.observation)
    scale_p = np.concatenate((scenario.datacenters.parameters.p_rated_kw, scenario.inverters.parameters.s_rated_kva))
    scale_q = np.concatenate((scenario.datacenters.parameters.q_max_kvar, scenario.inverters.parameters.s_rated_kva))
    for env_index in range(4):
        for i, agent in enumerate(scenario.agents):
            for rank in range(3):
                j = simulation.now.episode.placed.nearest[env_index, i, rank] - env_index * n
                wanted = [
                    (state.v_agent_pu[env_index, j] - 1) / 0.05,
                    state.p_kw[env_index, j] / scale_p[j],
                    state.q_kvar[env_index, j] / scale_q[j],
                ]
                seen = [found[agent][f"neighbour{rank}_{name}"][env_index] for name in ("v_deviation", "p", "q")]
                assert seen == pytest.approx(wanted, abs=1e-6)


def test_nothing_is_near_unless_it_is_observed():
    for scope in ("local", "feeder"):
        scenario = make_scenario("toy6", observe=scope)
        assert placed_at(scenario, [4, 3, 5]).nearest.shape == (1, 3, 0)


# --- over episodes -------------------------------------------------------------------------------


def raw(simulation: Simulation) -> np.ndarray:
    """The observation of the current step before it is cut to its bounds."""
    s, now = simulation.scenario, simulation.now
    share = episode.compute_share(s, now.episode, now.step + 1)
    coming = given(now.p_ref_next_kw, share)
    return observation.observe(s, now.state, now.episode.placed, coming, now.measured[1], now.measured[0])


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("scope", ["local", "neighbours", "feeder"])
@pytest.mark.parametrize("name", FORMS)
def test_everything_lies_within_its_bounds_by_itself(name, scope, law):
    scenario = make_scenario(name, observe=scope, horizon=40, **LAWS[law])
    low, high = observation.joint_bounds(scenario)
    simulation, transitions = play(scenario, 12, 40)
    for t in transitions:
        found = raw(simulation)
        assert t.observation.dtype == np.float32
        assert t.observation.shape == (12, len(low))
        assert np.all(found >= low - 1e-6)
        assert np.all(found <= high + 1e-6)
        np.testing.assert_allclose(t.observation, found, rtol=1e-6, atol=1e-6)  # hence cut nowhere
        assert np.all(t.observation >= low)
        assert np.all(t.observation <= high)


def test_fields_follow_the_episode():
    scenario = make_scenario("ieee33-weak", horizon=15)
    simulation, transitions = play(scenario, 3, 15)
    before: Transition | None = None
    for t in transitions:
        found, s = named(scenario, t.observation), t.state
        for i in range(3):
            site = found[f"dc_{i}"]
            np.testing.assert_allclose(site["p_ref_next"], simulation.now.p_ref_next_kw[:, i] / 1000.0, atol=1e-6)
            np.testing.assert_allclose(site["backlog"], s.backlog_kws[:, i] / 1000.0, rtol=1e-6, atol=1e-6)
            np.testing.assert_allclose(site["q_limit"], s.q_limit_kvar[:, i] / 330.0, rtol=1e-6)
        for i in range(4):
            np.testing.assert_allclose(found[f"inv_{i}"]["q"], s.q_kvar[:, 3 + i] / 100.0, atol=1e-6)
        for i, agent in enumerate(scenario.agents):
            bus = scenario.feeder.index((*(18, 33, 25), 7, 14, 20, 30)[i])
            np.testing.assert_allclose(found[agent]["v_deviation"], (s.v_pu[:, bus] - 1) / 0.05, atol=1e-5)
            last = s.v_pu if before is None else before.state.v_pu
            change = (s.v_pu[:, bus] - last[:, bus]) / 0.05
            np.testing.assert_allclose(found[agent]["v_change"], change, atol=1e-5)
        before = t


# --- measurement noise and delay -------------------------------------------------------------------


def test_measurement_noise_has_its_standard_deviation_and_reaches_no_physics():
    sigma = 0.004
    noisy, clean = (make_scenario("ieee33-weak", horizon=30, sensing={"noise_pu": s}) for s in (sigma, 0.0))
    n_env, errors, changes = 150, [], []
    for a, b in zip(play(noisy, n_env, 30)[1], play(clean, n_env, 30)[1], strict=True):
        np.testing.assert_array_equal(a.state.v_pu, b.state.v_pu)
        np.testing.assert_array_equal(a.reward, b.reward)
        seen, true = named(noisy, a.observation), named(clean, b.observation)
        errors.append([0.05 * (seen[agent]["v_deviation"] - true[agent]["v_deviation"]) for agent in seen])
        changes.append([0.05 * (seen[agent]["v_change"] - true[agent]["v_change"]) for agent in seen])
        for agent in seen:
            for name in ("p", "q", "q_limit", "r", "x"):
                np.testing.assert_array_equal(seen[agent][name], true[agent][name])
    error, change = np.array(errors), np.array(changes)  # (step, agent, row)
    assert error.mean() == pytest.approx(0.0, abs=5 * sigma / np.sqrt(error.size))
    assert error.std() == pytest.approx(sigma, rel=0.03)
    # Drawn anew at each step, for each agent and in each environment.
    for one, other in (
        (error[1:], error[:-1]), (error[:, 1:], error[:, :-1]), (error[..., 1:], error[..., :-1])
    ):  # fmt: skip
        assert abs(np.corrcoef(one.ravel(), other.ravel())[0, 1]) < 5 / np.sqrt(one.size)
    # A change is the difference of two measurements, the one before among them; at the reset there is none.
    np.testing.assert_allclose(change[1:], np.diff(error, axis=0), atol=1e-6)
    np.testing.assert_allclose(change[0], 0.0, atol=1e-9)


def test_measurement_noise_is_reproducible():
    scenario = make_scenario("toy6", horizon=8, sensing={"noise_pu": 0.01})
    one, again = (
        np.array([t.observation for t in play(scenario, 3, 8)[1]]),
        np.array([t.observation for t in play(scenario, 3, 8)[1]]),
    )
    np.testing.assert_array_equal(one, again)
    # Environment 2 is seed 2's episode in a batch of one too.
    simulation = Simulation(scenario, 1)
    np.testing.assert_array_equal(simulation.reset([2]).observation[0], one[0, 2])


@pytest.mark.parametrize("noise", [0.0, 0.003])
@pytest.mark.parametrize("delay", [0, 1, 3])
def test_a_delayed_measurement_is_that_of_so_many_steps_ago(delay, noise):
    late, prompt = (
        make_scenario("ieee33-weak", horizon=10, sensing={"delay_steps": d, "noise_pu": noise}) for d in (delay, 0)
    )
    old = [named(late, t.observation) for t in play(late, 4, 10)[1]]
    new = [named(prompt, t.observation) for t in play(prompt, 4, 10)[1]]
    for step in range(11):
        for agent in old[step]:
            then = new[max(step - delay, 0)][agent]  # until the first comes in, the reset's
            for name in ("v_deviation", "v_change"):
                np.testing.assert_allclose(old[step][agent][name], then[name], atol=1e-6, err_msg=f"{step} {name}")
            for name in set(old[step][agent]) - {"v_deviation", "v_change"}:  # what an agent knows of itself is new
                np.testing.assert_array_equal(old[step][agent][name], new[step][agent][name])


# --- NumPy and torch -------------------------------------------------------------------------------


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("scope", ["local", "neighbours", "feeder"])
@pytest.mark.parametrize("name", FORMS)
def test_numpy_and_torch_observe_alike(name, scope, law):
    scenario = make_scenario(name, observe=scope, **{"sensing.noise_pu": 0.01, "sensing.delay_steps": 1}, **LAWS[law])
    simulation, transitions = play(scenario, 4, 6)
    for _ in transitions:
        now = simulation.now
        share = episode.compute_share(scenario, now.episode, now.step + 1)
        found = observation.observe(
            scenario,
            now.state.map(torch.tensor),
            Placement(*map(torch.tensor, now.episode.placed)),
            given(torch.tensor(now.p_ref_next_kw), None if share is None else torch.tensor(share)),
            torch.tensor(now.measured[1]),
            torch.tensor(now.measured[0]),
        )
        assert found.dtype == torch.float64
        np.testing.assert_allclose(found.numpy(), raw(simulation), rtol=1e-12, atol=1e-12)


def test_observe_writes_to_nothing_that_it_is_given():
    scenario = make_scenario("toy6", observe="neighbours")
    inputs, placed = hand_made(), placed_at(scenario, [4, 3, 5])
    for array in (*fields_of(inputs["state"]).values(), inputs["given_next"][0].p_ref_kw, *placed):
        array.flags.writeable = False  # a write would raise
    observation.observe(scenario, placed=placed, **inputs)


def test_derivatives_pass_through_an_observation():
    scenario = make_scenario("toy6")
    inputs = hand_made()
    backlog = torch.tensor([[5000.0]], dtype=torch.float64, requires_grad=True)
    voltage = torch.tensor([[1.02, 0.97, 1.04]], dtype=torch.float64, requires_grad=True)
    state = with_fields(inputs["state"].map(torch.tensor), backlog_kws=backlog)
    placed = Placement(*map(torch.tensor, placed_at(scenario, [4, 3, 5])))
    joint = observation.observe(
        scenario, state, placed, given(torch.tensor([[2000.0]])), voltage, torch.tensor(inputs["v_before_pu"])
    )
    joint.sum().backward()
    assert backlog.grad is not None
    assert voltage.grad is not None
    np.testing.assert_allclose(backlog.grad, [[1 / 2500.0]])
    np.testing.assert_allclose(voltage.grad, [[2 / 0.05] * 3])

"""The physics of a step: on NumPy arrays and torch tensors alike, differentiable, pure, and balanced."""

from collections.abc import Callable
from importlib import import_module
from typing import Any, NamedTuple

import numpy as np
import pytest
import torch

from dcgrid_env import PrefillDecodeDvfs, Scenario, action_layout, distflow, lindistflow, make_scenario
from dcgrid_env.engine.cost import reward
from dcgrid_env.engine.exogenous import episode
from dcgrid_env.engine.physics import dynamics
from dcgrid_env.engine.physics.state import Exogenous, State
from helpers.forms import FORMS
from helpers.intervals import interval
from helpers.states import fields_of

LAWS: dict[str, dict[str, Any]] = {
    "linear": {},
    "work_classes": {"datacenters.clock_law": PrefillDecodeDvfs(), "datacenters.boost_share": 1.3},
}


class Outside(NamedTuple):
    """Exogenous inputs of an episode's first steps, t = 0 first, and the buses of the agents."""

    steps: list[Exogenous]
    buses: np.ndarray


def outside(scenario: Scenario, n_env: int, steps: int, *, full: bool = False, seed: int = 0) -> Outside:
    """``full``: every site is asked for 60 % of its rating or more, so that the clocks matter, of either work class."""
    drawn = episode.draw(scenario, np.arange(n_env, dtype=np.uint64) + np.uint64(seed), np.zeros(n_env, np.uint64))
    rng, noise, found = np.random.default_rng(seed), np.zeros((n_env, scenario.feeder.n_bus)), []
    for k in range(steps + 1):
        step = np.full(n_env, k)
        p_ref = episode.p_ref_kw(scenario, drawn, step)
        if full:
            p_ref = (
                rng.uniform(0.6, scenario.datacenters.boost_share, p_ref.shape)
                * scenario.datacenters.parameters.p_rated_kw
            )
        exogenous, noise = interval(scenario, drawn, step, noise, p_ref)
        if full and exogenous.compute_share is not None:
            exogenous = exogenous._replace(compute_share=rng.uniform(0.0, 1.0, p_ref.shape))
        found.append(exogenous)
    return Outside(found, drawn.buses)


def random_actions(scenario: Scenario, n_env: int, steps: int, seed: int = 0) -> np.ndarray:
    n = action_layout(scenario).n
    return np.random.default_rng(seed).uniform(-1.0, 1.0, (steps, n_env, n))


def as_torch(fields: Any) -> Any:
    """A tuple of arrays as one of tensors that share nothing with them."""
    if isinstance(fields, State):
        return fields.map(lambda array: torch.tensor(np.asarray(array)))
    return type(fields)._make(a if a is None else torch.tensor(np.asarray(a)) for a in fields)


def run(scenario: Scenario, given: list[Exogenous], actions: Any) -> list[tuple[State, Any]]:
    state, grid = dynamics.initial_state(scenario, given[0])
    course = [(state, grid.solution)]
    for action, exogenous in zip(actions, given[1:], strict=True):
        state, grid = dynamics.step(scenario, state, action, exogenous)
        course.append((state, grid.solution))
    return course


@pytest.fixture
def exact(monkeypatch: pytest.MonkeyPatch) -> None:
    """Power flows solved to the last digits instead of the default 1e-4 kVA."""
    monkeypatch.setitem(import_module("dcgrid_env.powerflow.balanced.distflow").TOLERANCE_KVA, 8, 1e-9)


def assert_alike(tensors: State, arrays: State, tolerance: float) -> None:
    for (field, a), b in zip(fields_of(arrays).items(), fields_of(tensors).values(), strict=True):
        assert b.dtype == torch.float64, field
        assert tuple(b.shape) == a.shape, field
        np.testing.assert_allclose(b.numpy(), a, rtol=tolerance, atol=tolerance, err_msg=field)


# --- NumPy and torch -----------------------------------------------------------------------------


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("power_flow", ["distflow", "lindistflow"])
@pytest.mark.parametrize("name", FORMS)
@pytest.mark.usefixtures("exact")
def test_numpy_and_torch_take_the_same_steps(name, power_flow, law):
    scenario = make_scenario(name, power_flow=power_flow, **LAWS[law])
    given = outside(scenario, 6, 6, full=True)
    actions = random_actions(scenario, 6, 6)
    arrays = run(scenario, given.steps, actions)
    tensors = run(scenario, [as_torch(e) for e in given.steps], torch.tensor(actions))
    for (state, solution), (state_t, solution_t) in zip(arrays, tensors, strict=True):
        assert solution.converged.all()
        assert bool(solution_t.converged.all())
        assert_alike(state_t, state, 1e-9)
        np.testing.assert_allclose(solution_t.loss_kw.numpy(), solution.loss_kw, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("name", FORMS)
def test_numpy_and_torch_agree_within_the_default_tolerance(name):
    scenario = make_scenario(name)
    given = outside(scenario, 6, 6, full=True)
    actions = random_actions(scenario, 6, 6)
    tensors = run(scenario, [as_torch(e) for e in given.steps], torch.tensor(actions))
    for (state, _), (state_t, _) in zip(run(scenario, given.steps, actions), tensors, strict=True):
        same = state_t._replace(restart=torch.tensor(state.restart))
        assert_alike(same, state, 1e-8)  # what the solver promises of its voltages
        np.testing.assert_allclose(state_t.restart.numpy(), state.restart, rtol=1e-6, atol=1e-9)
        for field in ("class_backlog_kws", "f_mhz", "arrived_kw", "served_kw", "p_kw", "q_kvar", "q_limit_kvar"):
            np.testing.assert_allclose(getattr(state_t, field).numpy(), getattr(state, field), rtol=1e-12, atol=1e-9)


# --- derivatives ---------------------------------------------------------------------------------


def team_cost(scenario: Scenario, given: list[Exogenous], actions: Any, start: State) -> Any:
    """Sum over environments and steps of the team's cost, the last step's with what is left over."""
    state, cost = start, 0.0
    for k, (action, exogenous) in enumerate(zip(actions, given, strict=True)):
        state, grid = dynamics.step(scenario, state, action, exogenous)
        last = grid.solution.converged & (k == len(given) - 1)
        cost = cost + reward.total(reward.team_costs(scenario, state, grid.solution, last)).sum()
    return cost


@pytest.mark.parametrize(
    ("name", "cost", "law"),
    [
        *((name, cost, "linear") for name in ("toy6", "ieee33-weak") for cost in ("l1", "l2", "bump")),
        ("toy6", "l1", "work_classes"),
        ("ieee33-weak", "l2", "work_classes"),
    ],
)
@pytest.mark.usefixtures("exact")
def test_gradient_through_three_steps_matches_finite_differences(name, cost, law):
    scenario = make_scenario(name, **{"cost.voltage": cost}, **LAWS[law])
    given = outside(scenario, 2, 3, full=True, seed=1)
    # Within (-0.8, 0.8): away from the ends, where the derivative has no one value.
    actions = 0.8 * random_actions(scenario, 2, 3, seed=1)
    start = dynamics.initial_state(scenario, given.steps[0])[0]

    variables = torch.tensor(actions, requires_grad=True)
    total = team_cost(scenario, [as_torch(e) for e in given.steps[1:]], variables, as_torch(start))
    total.backward()
    assert variables.grad is not None
    gradient = variables.grad.numpy()

    numeric, h = np.zeros_like(actions), 1e-5
    for at in np.ndindex(*actions.shape):
        ends = []
        for sign in (1.0, -1.0):
            moved = actions.copy()
            moved[at] += sign * h
            ends.append(team_cost(scenario, given.steps[1:], moved, start))
        numeric[at] = (ends[0] - ends[1]) / (2.0 * h)
    scale = np.abs(numeric).max()
    assert scale > 1e-3
    np.testing.assert_allclose(gradient, numeric, rtol=1e-5, atol=1e-6 * scale)
    clocks = gradient[..., 0 : 2 * scenario.datacenters.count : 2]
    assert (clocks != 0.0).mean() > 0.5  # a site that has nothing to be throttled knows no slope


def test_an_environment_without_solution_spoils_no_derivative():
    scenario = make_scenario("ieee33-weak")
    given = outside(scenario, 3, 2, full=True).steps
    start = as_torch(dynamics.initial_state(scenario, given[0])[0])
    actions = 0.5 * random_actions(scenario, 3, 2)
    gradients = []
    for load in (1.0, 200.0):
        first = given[1]._replace(p_load_kw=given[1].p_load_kw * np.array([[1.0], [load], [1.0]]))
        variables = torch.tensor(actions, requires_grad=True)
        team_cost(scenario, [as_torch(first), as_torch(given[2])], variables, start).backward()
        assert variables.grad is not None
        gradients.append(variables.grad.numpy())
    assert np.isfinite(gradients[1]).all()
    np.testing.assert_allclose(gradients[1][:, [0, 2]], gradients[0][:, [0, 2]], rtol=1e-4, atol=1e-4)


# --- purity --------------------------------------------------------------------------------------


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("collapse", [False, True])
def test_step_writes_to_nothing_that_it_is_given(collapse, law):
    scenario = make_scenario("ieee33-weak", **LAWS[law])
    given = outside(scenario, 3, 1).steps
    first = given[1]
    if collapse:
        first = first._replace(p_load_kw=first.p_load_kw * np.array([[1.0], [100.0], [1.0]]))
    state, _ = dynamics.initial_state(scenario, given[0])
    action = 2.0 * random_actions(scenario, 3, 1)[0]

    for arrays in (fields_of(state).values(), first, (action,)):
        for array in (a for a in arrays if isinstance(a, np.ndarray)):
            array.flags.writeable = False  # a write would raise
    after, _ = dynamics.step(scenario, state, action, first)
    for array in fields_of(after).values():
        assert not np.shares_memory(array, state.v_pu) or array is after.v_last_pu

    tensors = as_torch(state), torch.tensor(action), as_torch(first)
    every = [t for t in (*fields_of(tensors[0]).values(), tensors[1], *tensors[2]) if t is not None]
    before = [t.clone() for t in every]
    dynamics.step(scenario, *tensors)
    for a, b in zip(before, every, strict=True):
        assert torch.equal(a, b)
    again, _ = dynamics.step(scenario, state, action, first)
    for a, b in zip(fields_of(after).values(), fields_of(again).values(), strict=True):
        np.testing.assert_array_equal(a, b)


@pytest.mark.parametrize("law", LAWS)
def test_environments_do_not_touch_each_other(law):
    scenario = make_scenario("ieee123", **LAWS[law])
    given = outside(scenario, 5, 3, full=True)
    actions = random_actions(scenario, 5, 3)
    together = run(scenario, given.steps, actions)
    n_bus = scenario.feeder.n_bus
    for env_index in range(5):
        cut = slice(env_index, env_index + 1)
        alone_given = [
            Exogenous(
                *(a[cut] for a in e[:4]),  # type: ignore[arg-type]
                nodes=e.nodes[cut] - env_index * n_bus,
                compute_share=None if e.compute_share is None else e.compute_share[cut],
            )
            for e in given.steps
        ]
        alone = run(scenario, alone_given, actions[:, cut])
        for (a, _), (b, _) in zip(alone, together, strict=True):
            for x, y in zip(fields_of(a).values(), fields_of(b).values(), strict=True):
                np.testing.assert_allclose(x[0], y[env_index], rtol=1e-12, atol=1e-12)


# --- what reaches the grid -----------------------------------------------------------------------


@pytest.mark.parametrize("capacitors", [True, False])
@pytest.mark.parametrize("name", FORMS)
def test_substation_imports_what_is_drawn_and_lost(name, capacitors):
    scenario = make_scenario(name, background={"capacitors": capacitors})
    feeder, n_dc = scenario.feeder, scenario.datacenters.count
    given = outside(scenario, 4, 4, full=True)
    injected = (
        np.random.default_rng(2).uniform(0.0, 0.9, (4, scenario.inverters.count))
        * scenario.inverters.parameters.s_rated_kva
    )
    given = [e._replace(p_inverter_kw=injected) for e in given.steps]
    roots = feeder.parent == 0
    for (state, solution), e in zip(run(scenario, given, random_actions(scenario, 4, 4)), given, strict=True):
        p_import = solution.p_branch_kw[:, roots].sum(-1) + e.p_load_kw[:, 0]
        q_import = solution.q_branch_kvar[:, roots].sum(-1) + e.q_load_kvar[:, 0]
        p_drawn = e.p_load_kw.sum(-1) + state.p_kw[:, :n_dc].sum(-1) - injected.sum(-1)
        q_drawn = e.q_load_kvar.sum(-1) - state.q_kvar.sum(-1)
        x_loss = (feeder.x_pu * solution.current_sq_pu).sum(-1) * 1000.0
        r_loss = (feeder.r_pu * solution.current_sq_pu).sum(-1) * 1000.0
        np.testing.assert_allclose(solution.loss_kw, r_loss, rtol=1e-6)
        assert np.all(r_loss > 0)
        np.testing.assert_allclose(p_import, p_drawn + solution.loss_kw, atol=1e-2)
        np.testing.assert_allclose(q_import, q_drawn + x_loss, atol=1e-2)
        np.testing.assert_allclose(state.p_kw[:, n_dc:], -injected)


def test_power_flow_gets_the_loads_at_the_agents_buses():
    scenario = make_scenario("ieee123")
    given = outside(scenario, 3, 2, full=True)
    (_, (state, _), _), e = run(scenario, given.steps, random_actions(scenario, 3, 2)), given.steps[1]
    p_net, q_net = e.p_load_kw.copy(), e.q_load_kvar.copy()
    for env_index in range(3):
        for agent, bus in enumerate(given.buses[env_index]):
            p_net[env_index, bus] += state.p_kw[env_index, agent]
            q_net[env_index, bus] -= state.q_kvar[env_index, agent]  # an injection against a load
    again = distflow(scenario.feeder, p_net, q_net, scenario.source_voltage_pu)
    np.testing.assert_allclose(state.v_pu, again.v_pu, atol=1e-8)
    np.testing.assert_allclose(state.v_agent_pu, np.take_along_axis(state.v_pu, given.buses, 1), rtol=0)
    assert np.all(state.v_pu[:, 0] == 1.04375)


def test_toy6_voltages_worked_by_hand():
    # Without losses, each branch 0.01 + j0.02: v = 1 - 2 (R p + X q), MW and Mvar on shared paths. The site at bus 4
    # draws 2.5 MW and gives 0.33 x 2.5 x 0.8 = 0.66 Mvar; the inverter at 5 gives 0.5 Mvar, the one at 3 takes 0.25.
    scenario = make_scenario("toy6", power_flow="lindistflow", background={"load_sigma": 0.0})
    given = outside(scenario, 1, 1).steps
    full = given[1]._replace(p_ref_kw=np.array([[2500.0]]))
    state, _ = dynamics.initial_state(scenario, given[0])
    state, _ = dynamics.step(scenario, state, np.array([[1.0, 0.8, -0.25, 0.5]]), full)
    p = {2: 0.2, 3: 0.3, 4: 2.5, 5: 0.1}
    q = {2: 0.1, 3: 0.15 + 0.25, 4: -0.66, 5: 0.05 - 0.5}
    flow = {
        1: (p[2] + p[3], q[2] + q[3]), 2: (p[2], q[2]), 3: (p[3], q[3]), 4: (p[4] + p[5], q[4] + q[5]), 5: (p[5], q[5])
    }  # fmt: skip
    v = {0: 1.0}
    for bus, parent in ((1, 0), (2, 1), (3, 1), (4, 0), (5, 4)):
        v[bus] = v[parent] - 2.0 * (0.01 * flow[bus][0] + 0.02 * flow[bus][1])
    np.testing.assert_allclose(state.v_pu[0], [np.sqrt(v[bus]) for bus in range(6)], rtol=1e-12)
    np.testing.assert_allclose(state.p_kw, [[2500.0, 0.0, 0.0]])
    np.testing.assert_allclose(state.q_kvar, [[660.0, -250.0, 500.0]])


def test_capacitors_raise_the_voltage():
    voltages, feeder = [], make_scenario("ieee123").feeder
    for capacitors in (True, False):
        scenario = make_scenario("ieee123", background={"capacitors": capacitors})
        voltages.append(dynamics.initial_state(scenario, outside(scenario, 1, 0).steps[0])[0].v_pu[0])
    rise = voltages[0] - voltages[1]
    assert np.all(rise >= -1e-9)
    assert np.all(rise[feeder.capacitor_kvar > 0] > 0.002)


# --- actions -------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", FORMS)
def test_actions_beyond_the_ends_act_as_the_ends(name):
    scenario = make_scenario(name)
    given = outside(scenario, 4, 1, full=True).steps
    state, _ = dynamics.initial_state(scenario, given[0])
    beyond = 5.0 * random_actions(scenario, 4, 1)[0]
    assert np.any(np.abs(beyond) > 1)
    one, _ = dynamics.step(scenario, state, beyond, given[1])
    two, _ = dynamics.step(scenario, state, np.clip(beyond, -1.0, 1.0), given[1])
    three, _ = dynamics.step(scenario, as_torch(state), torch.tensor(beyond), as_torch(given[1]))
    for a, b, c in zip(*(fields_of(state).values() for state in (one, two, three)), strict=True):
        np.testing.assert_array_equal(a, b)
        np.testing.assert_allclose(c.numpy(), b, rtol=1e-7, atol=1e-8)


def test_clock_and_setpoint_of_an_action():
    scenario = make_scenario("ieee33-weak", datacenters={"f_min_mhz": 300.0, "f_max_mhz": 1500.0})
    given = outside(scenario, 1, 1).steps
    state, _ = dynamics.initial_state(scenario, given[0])
    idle = given[1]._replace(p_ref_kw=np.array([[230.0, 100.0, 0.0]]))
    # Clock and q of dc_0, dc_1, dc_2 in turn, then the inverters' q.
    action = np.array([[1.0, 0.1, -1.0, 0.2, 0.25, -0.3, 0.4, -0.5, 1.0, -1.0]])
    after, _ = dynamics.step(scenario, state, action, idle)
    np.testing.assert_allclose(after.f_mhz, [[1500.0, 300.0, 1050.0]])
    np.testing.assert_allclose(after.f_last_mhz, [[1500.0] * 3])
    # Shares of 0.33 x 1000 kvar, and of the inverters' 100.
    np.testing.assert_allclose(after.q_kvar, [[33.0, 66.0, -99.0, 40.0, -50.0, 100.0, -100.0]])
    np.testing.assert_allclose(after.p_kw, [[230.0, 100.0, 0.0, 0.0, 0.0, 0.0, 0.0]])
    np.testing.assert_allclose(after.q_limit_kvar, [[330.0] * 3 + [100.0] * 4])
    again, _ = dynamics.step(scenario, after, np.zeros((1, 10)), idle)
    np.testing.assert_allclose(again.f_last_mhz, after.f_mhz)
    np.testing.assert_allclose(again.f_mhz, [[900.0] * 3])
    np.testing.assert_allclose(again.v_last_pu, after.v_pu)
    np.testing.assert_allclose(again.v_agent_last_pu, after.v_agent_pu)


def test_reactive_power_is_cut_after_the_active_power_is_known():
    # s = 1020 kVA: at 1000 kW 201 kvar are left of the 330; at half the clock p = 230 + 385 and all of them are.
    scenario = make_scenario("ieee33-weak")
    given = outside(scenario, 1, 1).steps
    state, _ = dynamics.initial_state(scenario, given[0])
    full = given[1]._replace(p_ref_kw=np.full((1, 3), 1000.0))
    half = 2.0 * (705.0 - 210.0) / 1200.0 - 1.0
    action = np.array([[1.0, 1.0, 1.0, -1.0, half, 1.0, 0.0, 0.0, 0.0, 0.0]])
    after, _ = dynamics.step(scenario, state, action, full)
    left = np.sqrt(1020.0**2 - 1000.0**2)
    np.testing.assert_allclose(after.p_kw[0, :3], [1000.0, 1000.0, 615.0])
    np.testing.assert_allclose(after.q_kvar[0, :3], [left, -left, 330.0])
    np.testing.assert_allclose(after.q_limit_kvar[0, :3], [left, left, 330.0])
    np.testing.assert_allclose(after.backlog_kws, [[0.0, 0.0, 385.0]], atol=1e-9)
    np.testing.assert_allclose(after.arrived_kw, [[770.0] * 3])
    np.testing.assert_allclose(after.served_kw, [[770.0, 770.0, 385.0]])


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("kind", ["numpy", "torch"])
@pytest.mark.parametrize("name", FORMS)
def test_initial_state_is_at_the_top_clock_without_reactive_power(name, kind, law):
    scenario = make_scenario(name, **LAWS[law])
    given = outside(scenario, 3, 0, full=True).steps[0]
    state, grid = dynamics.initial_state(scenario, given if kind == "numpy" else as_torch(given))
    state = state.map(np.asarray)
    n_dc, n_bus = scenario.datacenters.count, scenario.feeder.n_bus
    assert np.all(state.f_mhz == scenario.datacenters.f_max_mhz)
    assert np.all(state.f_last_mhz == scenario.datacenters.f_max_mhz)
    assert np.all(state.q_kvar == 0.0)
    np.testing.assert_allclose(state.backlog_kws, 0.0, atol=1e-9)
    assert state.class_backlog_kws.shape == ((3, n_dc, 2) if law == "work_classes" else (3, n_dc))
    np.testing.assert_allclose(state.p_kw[:, :n_dc], given.p_ref_kw)
    np.testing.assert_array_equal(state.v_last_pu, state.v_pu)
    np.testing.assert_array_equal(state.v_agent_last_pu, state.v_agent_pu)
    assert np.all(state.v_pu[:, 0] == scenario.source_voltage_pu)
    assert state.v_pu.shape == (3, n_bus)
    assert state.restart.shape == (3, n_bus - 1)
    assert state.p_kw.shape == state.q_kvar.shape == state.v_agent_pu.shape == (3, scenario.n_agents)
    assert bool(grid.solution.converged.all())


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("n_dc", [0, 1])
def test_no_datacenter_or_no_inverter_at_all(n_dc, law):
    scenario = make_scenario("toy6", n_datacenters=n_dc, **{"datacenters.buses": (4,) * n_dc}, **LAWS[law])
    if n_dc:
        scenario = scenario.replace(inverters={"buses": ()})
    given = outside(scenario, 2, 2).steps
    actions = random_actions(scenario, 2, 2)
    for arrays, tensors in zip(
        run(scenario, given, actions), run(scenario, [as_torch(e) for e in given], torch.tensor(actions)), strict=True
    ):
        for a, b in zip(fields_of(arrays[0]).values(), fields_of(tensors[0]).values(), strict=True):
            np.testing.assert_allclose(b.numpy(), a, rtol=1e-9, atol=1e-9)


# --- work classes and boost ----------------------------------------------------------------------------


def test_one_work_class_has_the_same_arrays_by_work_class_and_in_total():
    scenario = make_scenario("ieee33-weak")
    given = outside(scenario, 2, 1, full=True).steps
    state = run(scenario, given, random_actions(scenario, 2, 1))[1][0]
    assert state.class_backlog_kws is state.backlog_kws
    assert state.class_arrived_kw is state.arrived_kw
    assert state.class_served_kw is state.served_kw
    assert given[1].compute_share is None


def test_composition_decides_speed_and_draw():
    # One site all compute-bound, one all memory-bound, one half and half, all full at half the clock: see the law.
    scenario = make_scenario(
        "ieee33-weak", datacenters={"f_min_mhz": 705.0, "clock_law": PrefillDecodeDvfs(0.1, 0.2, 0.4)}
    )
    given = outside(scenario, 1, 1).steps
    state, _ = dynamics.initial_state(scenario, given[0]._replace(p_ref_kw=np.full((1, 3), 230.0)))
    full = given[1]._replace(p_ref_kw=np.full((1, 3), 1000.0), compute_share=np.array([[1.0, 0.0, 0.5]]))
    low = np.array([[-1.0, 0.0, -1.0, 0.0, -1.0, 0.0, 0.0, 0.0, 0.0, 0.0]])
    state, _ = dynamics.step(scenario, state, low, full)
    # Speeds 1/2 and 1/1.1; tau 2, 1.1 and 1.55; busy power 0.4/2 + 0.6/8 = 0.275 and 0.2 + 0.8/8 = 0.3.
    served = np.array([[[1 / 2, 0.0], [0.0, 1 / 1.1], [0.5 / 1.55, 0.5 / 1.55]]])
    np.testing.assert_allclose(state.class_served_kw, 770.0 * served)
    np.testing.assert_allclose(state.served_kw, 770.0 * served.sum(-1))
    np.testing.assert_allclose(state.class_arrived_kw, [[[770.0, 0.0], [0.0, 770.0], [385.0, 385.0]]])
    np.testing.assert_allclose(state.class_backlog_kws, state.class_arrived_kw - state.class_served_kw)
    np.testing.assert_allclose(state.backlog_kws, state.class_backlog_kws.sum(-1))
    busy = [0.275, 0.3, (0.5 * 2 * 0.275 + 0.5 * 1.1 * 0.3) / 1.55]
    np.testing.assert_allclose(state.p_kw[:, :3], [230.0 + 770.0 * np.array(busy)])


@pytest.mark.parametrize("law", ["linear", "work_classes"])
def test_a_short_draw_above_the_rating_is_served_at_once_and_leaves_no_reactive_power(law):
    scenario = make_scenario("ieee33-weak", **(LAWS[law] | {"datacenters.boost_share": 1.3}))
    given = outside(scenario, 1, 1).steps
    state, _ = dynamics.initial_state(scenario, given[0])
    above = given[1]._replace(p_ref_kw=np.array([[1300.0, 1010.0, 900.0]]))
    after, _ = dynamics.step(scenario, state, np.ones((1, 10)), above)
    np.testing.assert_allclose(after.p_kw[0, :3], [1300.0, 1010.0, 900.0])
    np.testing.assert_allclose(after.backlog_kws, 0.0, atol=1e-9)
    # s is 1020 kVA.
    np.testing.assert_allclose(after.q_limit_kvar[0, :3], [0.0, np.sqrt(1020.0**2 - 1010.0**2), 330.0])
    np.testing.assert_allclose(after.q_kvar[0, :3], after.q_limit_kvar[0, :3])
    assert np.isfinite(after.v_pu).all()


# --- a device at several nodes -------------------------------------------------------------------


@pytest.mark.parametrize("kind", ["numpy", "torch"])
def test_a_device_at_two_nodes_shares_its_power_and_sees_the_mean(kind):
    convert: Callable[[Any], Any] = as_torch if kind == "torch" else lambda fields: fields
    scenario = make_scenario("toy6", inverters={"buses": (3,)}, background={"load_sigma": 0.0})
    base = outside(scenario, 2, 1).steps
    at = np.array([[4, 5], [2, 3]])  # the site at buses 4 and 5, the inverter at 2 and 3
    nodes = at + 6 * np.arange(2)[:, None, None]
    first, second = (
        e._replace(nodes=nodes, p_ref_kw=np.array([[2000.0], [1000.0]]), p_inverter_kw=np.array([[300.0], [0.0]]))
        for e in base
    )
    state, _ = dynamics.initial_state(scenario, convert(first))
    action = np.array([[1.0, 0.5, -0.4], [1.0, -0.5, 1.0]])
    state, grid = dynamics.step(scenario, state, torch.tensor(action) if kind == "torch" else action, convert(second))
    state = state.map(np.asarray)
    np.testing.assert_allclose(state.p_kw, [[2000.0, -300.0], [1000.0, 0.0]])
    np.testing.assert_allclose(state.q_kvar, [[412.5, -400.0], [-412.5, 1000.0]])
    p, q = second.p_load_kw.copy(), second.q_load_kvar.copy()
    for agent in range(2):
        for node in at[agent]:
            p[:, node] += state.p_kw[:, agent] / 2
            q[:, node] -= state.q_kvar[:, agent] / 2
    np.testing.assert_allclose(state.v_pu, distflow(scenario.feeder, p, q, 1.0).v_pu, atol=1e-8)
    seen = [[v[[4, 5]].mean(), v[[2, 3]].mean()] for v in state.v_pu]
    np.testing.assert_allclose(state.v_agent_pu, seen, rtol=1e-14)
    assert bool(grid.solution.converged.all())


@pytest.mark.parametrize("n_node", [1, 2, 3])
@pytest.mark.parametrize("n_agent", [1, 2, 4])
def test_any_number_of_agents_at_any_number_of_nodes(n_agent, n_node):
    n_env, n_bus = 5, 20
    rng = np.random.default_rng(0)
    at = np.array([rng.permutation(n_bus)[: n_agent * n_node] for _ in range(n_env)]).reshape(n_env, n_agent, n_node)
    nodes = at + n_bus * np.arange(n_env)[:, None, None]
    power, v_pu = rng.normal(size=(n_env, n_agent)), rng.uniform(0.9, 1.1, (n_env, n_bus))
    np.testing.assert_allclose(dynamics._to_nodes(power, nodes), np.repeat(power[..., None] / n_node, n_node, axis=-1))
    wanted = [[v_pu[env_index, at[env_index, agent]].mean() for agent in range(n_agent)] for env_index in range(n_env)]
    np.testing.assert_allclose(dynamics.from_nodes(v_pu, nodes), wanted)


# --- voltage collapse ----------------------------------------------------------------------------


@pytest.mark.parametrize("kind", ["numpy", "torch"])
@pytest.mark.parametrize("name", FORMS)
def test_collapse_keeps_the_last_voltages_and_spoils_no_other_environment(name, kind):
    convert: Callable[[Any], Any] = as_torch if kind == "torch" else lambda fields: fields
    scenario = make_scenario(name)
    given = outside(scenario, 3, 3).steps
    actions = random_actions(scenario, 3, 3)
    sound = run(scenario, given, actions)
    too_much = given[2]._replace(p_load_kw=given[2].p_load_kw * np.array([[1.0], [200.0], [1.0]]))
    mixed = [given[0], given[1], too_much, given[3]]
    course = run(scenario, [convert(e) for e in mixed], torch.tensor(actions) if kind == "torch" else actions)
    for k, ((state, solution), (wanted, _)) in enumerate(zip(course, sound, strict=True)):
        assert np.asarray(solution.converged).tolist() == [True, k != 2, True]
        for (field, a), b in zip(fields_of(state).items(), fields_of(wanted).values(), strict=True):
            found = np.asarray(a)
            assert np.isfinite(found).all(), field
            np.testing.assert_allclose(found[[0, 2]], b[[0, 2]], rtol=1e-8, atol=1e-8, err_msg=field)
        assert all(np.isfinite(np.asarray(a)).all() for a in solution._replace(residual_kva=0.0))
    before, fallen, after = (s.map(np.asarray) for s, _ in course[1:])
    for field in ("v_pu", "v_agent_pu", "restart"):
        np.testing.assert_array_equal(getattr(fallen, field)[1], getattr(before, field)[1])
    np.testing.assert_array_equal(fallen.v_last_pu[1], before.v_pu[1])
    # The devices go on; once the load is gone the power flow has a solution again.
    assert not np.array_equal(fallen.q_kvar[1], before.q_kvar[1])
    np.testing.assert_allclose(after.v_pu[1], sound[3][0].v_pu[1], atol=1e-7)


@pytest.mark.parametrize("power_flow", ["distflow", "lindistflow"])
def test_a_site_beyond_the_feeder_collapses_it_unless_it_is_throttled(power_flow):
    scenario = make_scenario("toy6", datacenters={"p_rated_kw": 100_000.0}, power_flow=power_flow)
    given = outside(scenario, 2, 1).steps
    state, grid = dynamics.initial_state(scenario, given[0]._replace(p_ref_kw=np.array([[1000.0], [1000.0]])))
    assert grid.solution.converged.all()
    full = given[1]._replace(p_ref_kw=np.array([[100_000.0], [1000.0]]))
    after, grid = dynamics.step(scenario, state, np.array([[1.0, 0.0, 0.0, 0.0]] * 2), full)
    assert grid.solution.converged.tolist() == [False, True]
    assert after.v_pu[0].tolist() == state.v_pu[0].tolist()
    assert np.isfinite(after.v_pu).all()
    assert after.p_kw[0, 0] == pytest.approx(100_000.0)


def test_collapse_at_the_reset_starts_from_the_substations_voltage():
    scenario = make_scenario("ieee33-weak")
    given = outside(scenario, 2, 0).steps[0]
    too_much = given._replace(p_load_kw=given.p_load_kw * np.array([[500.0], [1.0]]))
    state, grid = dynamics.initial_state(scenario, too_much)
    assert grid.solution.converged.tolist() == [False, True]
    assert np.all(state.v_pu[0] == 1.05)
    assert all(np.isfinite(a).all() for a in fields_of(state).values())


def test_linear_power_flow_has_no_losses_and_no_lower_voltage():
    course = {}
    for power_flow in ("distflow", "lindistflow"):
        scenario = make_scenario("ieee33-weak", power_flow=power_flow)
        course[power_flow] = run(scenario, outside(scenario, 4, 2, full=True).steps, random_actions(scenario, 4, 2))
    for (exact, exact_solution), (linear, linear_solution) in zip(*course.values(), strict=True):
        assert np.all(linear_solution.loss_kw == 0.0)
        assert np.all(exact_solution.loss_kw > 0.0)
        assert np.all(linear.v_pu >= exact.v_pu - 1e-9)
    assert lindistflow(make_scenario("toy6").feeder, np.zeros(6), np.zeros(6)).v_pu.tolist() == [1.0] * 6

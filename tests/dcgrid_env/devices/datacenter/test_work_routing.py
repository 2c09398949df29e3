"""Work moved between sites: conserved over all of them, alike in every form, and refused where it cannot be."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from dcgrid_env import DcgridVectorEnv, Fault, Routing, ScenarioError, TensorEnv, action_layout, make_scenario
from dcgrid_env.devices import DataCenterParams, DataCenters, Work
from dcgrid_env.devices.datacenter.moved_requests import by_site
from dcgrid_env.devices.datacenter.site_features import Load
from dcgrid_env.devices.datacenter.ups_site import UpsState
from dcgrid_env.devices.datacenter.work_routing import RoutedSites
from dcgrid_env.traces import RequestTimes
from helpers.routing import routed

SHARES = st.lists(st.floats(-1.0, 1.0), min_size=3, max_size=3)
ARRIVED = st.lists(st.floats(0.0, 700.0), min_size=3, max_size=3)


def params() -> DataCenterParams:
    return DataCenters(count=3, p_rated_kw=(500.0, 800.0, 1000.0), s_rated_share=1.1, q_max_share=0.3).parameters


def moved(route: Any, arrived: Any, share: float = 1.0, available: Any = None) -> tuple[Any, Load]:
    feature = RoutedSites(Routing(movable_share=share))
    zero = 0.0 * arrived
    state: Any = type("NoFeatures", (), {"features": ()})()
    load, work = Load(zero, arrived, None), Work(arrived, None, available)
    figures = DataCenterParams(*(torch.tensor(x) for x in params())) if isinstance(arrived, torch.Tensor) else params()
    return feature.admit(figures, state, feature.initial(figures, zero), load, (route,), work, 1.0)


@settings(max_examples=200, deadline=None)
@given(SHARES, ARRIVED, st.floats(0.0, 1.0, allow_subnormal=False))
@pytest.mark.slow
def test_work_is_conserved_and_no_site_gives_or_takes_more_than_it_may(route, arrived, share):
    at, r = np.array([arrived]), np.array([route])
    own, load = moved(r, at, share)
    assert load.arrived_kw.sum() == pytest.approx(at.sum(), rel=1e-12, abs=1e-9)
    assert np.all(own.sent_kw <= share * at * np.maximum(-r, 0.0) + 1e-9)
    assert np.all(own.received_kw <= params().p_dynamic_kw * np.maximum(r, 0.0) + 1e-9)
    assert np.all(load.arrived_kw >= -1e-9)
    assert own.sent_kw.sum() == pytest.approx(own.received_kw.sum(), rel=1e-12, abs=1e-9)
    on_tensors = moved(torch.tensor(r), torch.tensor(at), share)[1].arrived_kw
    assert on_tensors.numpy() == pytest.approx(load.arrived_kw, rel=1e-12, abs=1e-9)


def test_at_rest_every_site_keeps_its_own_work():
    arrived = np.array([[100.0, 0.0, 300.0]])
    own, load = moved(0.0 * arrived, arrived)
    assert np.array_equal(load.arrived_kw, arrived)
    assert not own.received_kw.any()
    plain = make_scenario("ieee33", trace="code", horizon=20)
    figures = []
    for s in (plain, plain.replace(datacenters={"routing": Routing()})):
        env = DcgridVectorEnv(2, s)
        env.reset(seed=[3, 4])
        names = action_layout(s).names
        for _ in range(20):
            env.step(np.array([[{"clock": 0.2, "q": 0.5}.get(name, 0.0) for _, name in names]] * 2, np.float32))
        figures.append(env.transition)
    assert np.array_equal(figures[0].j_so_far, figures[1].j_so_far)
    assert np.array_equal(figures[0].state.v_pu, figures[1].state.v_pu)


def test_what_is_moved_goes_to_the_room_there_is():
    arrived = np.array([[200.0, 50.0, 0.0]])
    own, load = moved(np.array([[-1.0, 0.0, 0.1]]), arrived)
    room = 0.1 * params().p_dynamic_kw[2]
    assert load.arrived_kw[0] == pytest.approx([200.0 - room, 50.0, room])
    assert own.work_share[0] == pytest.approx(load.arrived_kw[0] / 250.0)
    lost = np.array([[1.0, 1.0, 0.0]])
    assert np.array_equal(moved(np.array([[-1.0, 0.0, 0.1]]), arrived, available=lost)[1].arrived_kw, arrived)


@pytest.mark.parametrize(
    ("share", "available", "room"),
    [(None, None, 1.0), (None, 0.0, 0.0), (0.5, None, 0.5), (0.5, 1.0, 0.5), (0.5, 0.0, 0.0), (0.0, 1.0, 0.0)],
)
def test_a_site_takes_work_by_the_share_of_it_that_is_on_the_grid(share, available, room):
    one, zero = np.ones((1, 3)), np.zeros((1, 3))
    link: Any = SimpleNamespace(share=one * [1.0, 1.0, 1.0 if share is None else share])
    battery: Any = None
    ups = UpsState(link, battery)
    state: Any = SimpleNamespace(features=() if share is None else (ups,))
    work = Work(one, None, None if available is None else one * [1.0, 1.0, available])
    feature = RoutedSites(Routing())
    load, route = Load(zero, one * [900.0, 0.0, 0.0], None), one * [-1.0, 0.0, 0.5]
    own, load = feature.admit(params(), state, feature.initial(params(), zero), load, (route,), work, 1.0)
    assert own.received_kw[0, 2] == pytest.approx(room * 0.5 * params().p_dynamic_kw[2])
    assert load.arrived_kw.sum() == pytest.approx(900.0)
    assert load.moved_kw is own.received_kw


def test_moved_work_keeps_its_compute_bound_share():
    zero, feature = np.zeros((1, 3)), RoutedSites(Routing())
    load = Load(zero, np.array([[100.0, 60.0, 40.0]]), np.array([[0.8, 0.2, 0.5]]))
    route, state = np.array([[-1.0, -0.5, 1.0]]), SimpleNamespace(features=())
    figures: Any = params(), state, feature.initial(params(), zero), load, (route,), Work(zero, None), 1.0
    own, after = feature.admit(*figures)
    np.testing.assert_allclose(own.sent_kw, [[100.0, 30.0, 0.0]])
    assert after.compute_share is not None
    np.testing.assert_allclose(after.arrived_kw, [[0.0, 30.0, 170.0]], atol=1e-9)
    np.testing.assert_allclose(after.compute_share[0, 1:], [0.2, (0.5 * 40.0 + 0.8 * 100.0 + 0.2 * 30.0) / 170.0])
    np.testing.assert_allclose(own.work_share, [[0.0, 0.15, 0.85]], atol=1e-9)


def test_it_has_a_derivative_by_what_is_given_and_taken():
    route = torch.tensor([[-0.5, 0.4, 0.6]], dtype=torch.float64, requires_grad=True)
    arrived = torch.tensor([[400.0, 0.0, 10.0]], dtype=torch.float64)
    moved(route, arrived)[1].arrived_kw[0, 1].backward()
    assert route.grad is not None
    assert torch.isfinite(route.grad).all()
    assert route.grad[0, 0] < 0.0 < route.grad[0, 1]
    still = torch.zeros((1, 3), dtype=torch.float64, requires_grad=True)
    moved(still, arrived)[1].arrived_kw.square().sum().backward()
    assert still.grad is not None
    assert torch.isfinite(still.grad).all()


@pytest.mark.parametrize(
    "changes",
    [
        {},
        {"datacenters.clock_law": "prefill-decode", "datacenters.boost_share": 1.2},
        {"faults": [Fault(("datacenter",), (2.0, 6.0))]},
    ],
)
@pytest.mark.slow
def test_one_environment_a_batch_and_tensors_agree_and_no_work_is_lost(changes):
    s = routed(**changes)
    rng, n = np.random.default_rng(5), action_layout(s).n
    actions = rng.uniform(-1.0, 1.0, (s.horizon, 2, n)).astype(np.float32)
    batch, one = DcgridVectorEnv(2, s), DcgridVectorEnv(1, s)
    tensors = TensorEnv(s, like=torch.empty(0, dtype=torch.float64))
    plain = DcgridVectorEnv(2, s.replace(datacenters={"routing": None, "batching": None, "service": None}))
    batch.reset(seed=[6, 7])
    one.reset(seed=[7])
    plain.reset(seed=[6, 7])
    tensors.reset([6, 7])
    balance = 0.0
    came = 0.0
    for joint in actions:
        queued = batch.transition.state.backlog_kws.sum(-1)
        batch.step(joint)
        one.step(joint[1:])
        plain.step(np.zeros((2, action_layout(plain.scenario).n), np.float32))
        step = tensors.step(torch.tensor(joint, dtype=torch.float64))
        state = batch.transition.state
        assert batch.transition.reward[1] == one.transition.reward[0]
        assert step.cost_j.numpy() == pytest.approx(batch.transition.cost_j, rel=1e-5, abs=1e-7)
        assert state.arrived_kw.sum(-1) == pytest.approx(plain.transition.state.arrived_kw.sum(-1), rel=1e-9)
        balance = state.backlog_kws.sum(-1) - queued - (state.arrived_kw - state.served_kw).sum(-1) * s.dt_s
        assert np.abs(balance).max() < 1e-6
        assert state.devices[0].slack_kws.sum(-1) == pytest.approx(state.backlog_kws, abs=1e-6)
        came += state.devices[0].received_kw.sum()
    assert came > 0.0


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"datacenters.routing": {"movable_share": 1.2}}, "routing.movable_share is 1.2.*in \\[0, 1\\]"),
        ({"datacenters.routing": {"move_latency_s": -1.0}}, "move_latency_s is -1.0; give a finite number"),
        ({"datacenters.routing": {"move_latency_s": 2.0}}, "move_latency_s is 2.0; give at most one step, dt_s = 1"),
        (
            {"datacenters.routing": {"share": 1.0}},
            "datacenters.routing.share is no field; .*its fields are movable_share",
        ),
        ({"datacenters.routing": 3}, "routing is 3; give Routing\\(...\\) or a mapping of its fields, or None"),
        ({"datacenters.batching": {"lowest": 64.0, "highest": 8.0}}, "lowest is 64.0; give less than highest = 8"),
        ({"datacenters.batching": {"reference": 1024.0}}, "reference is 1024.0; give a size from 8 to 512"),
        ({"datacenters.service": {"deadline_s": 0.0}}, "deadline_s is 0.0; give a finite number"),
        ({"datacenters.service": {"deadline_s": 1.0}}, "deadline_s is 1.0; give more than target_s = 2"),
        ({"datacenters.service": {"deadline_s": 601.0}}, "deadline_s is 601.0; give at most 600 steps, 600 s"),
        ({"datacenters.service": {"order": "lifo"}}, "order is 'lifo'; choose one of edf, fcfs"),
    ],
)
def test_what_cannot_be_is_refused_by_name(changes, message):
    with pytest.raises(ScenarioError, match=message):
        make_scenario("ieee33", **changes)


def test_requests_are_followed_to_the_site_that_serves_them():
    n, arrivals = 4000, np.linspace(0.0, 3.999, 4000)
    times = RequestTimes(arrivals, np.zeros(n), np.zeros(n), np.zeros(n))
    arrived = np.array([[0.0, 0.0, 0.0]] + [[60.0, 30.0, 10.0]] * 4)
    sent, received = np.zeros((5, 3)), np.zeros((5, 3))
    sent[1:, 0], received[1:, 1], received[1:, 2] = 40.0, 30.0, 10.0
    history: Any = type("History", (), {"arrived_kw": arrived, "sent_kw": sent, "received_kw": received})()
    none = RequestTimes(*(np.zeros(0),) * len(times))
    parts = list(by_site([(times, 0.0), (none, 0.0), (none, 0.0)], history, 1.0))
    share = {(site, came): len(part.arrival_s) / n for part, _, site, came in parts}
    # Of 100 kW that come to the first site 40 leave, 30 of them to the second.
    assert [share[i, 0] for i in range(3)] == pytest.approx([0.6, 0.3, 0.1], abs=0.01)
    assert sum(len(part.arrival_s) for part, *_ in parts) == n

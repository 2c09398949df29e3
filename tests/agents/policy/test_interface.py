"""What networks see of a scenario and what their outputs do, worked by hand on toy6 and alike for NumPy and torch."""

import numpy as np
import pytest
import torch

from dcgrid_env import PrefillDecodeDvfs, TensorEnv, field_names, make_scenario
from dcgrid_env.agents.policy.interface import KINDS, OUTPUTS, Gains, PolicyInterface, cut
from dcgrid_env.baselines import Droop
from dcgrid_env.engine.cost.observation import joint_bounds

TOY6 = make_scenario("toy6", split="train")  # dc_0 of 2.5 MW and 0.825 Mvar, then inverters of 1 MVA and 1 Mvar
FIELDS = ("v_deviation", "v_change", "p", "q", "q_limit", "r", "x", "p_ref_next", "backlog")
SLOWEST = 210.0 / 1410.0
GAINS = Gains(k_p_mw_per_pu=10.0, k_q_mvar_per_pu_s=0.5, alpha_per_s=0.3)


def joint_of(dc, *inverters):
    """A joint observation of toy6, (1, 23), from the fields that are not 0."""
    agents = [(dc, FIELDS), *((inverter, FIELDS[:7]) for inverter in inverters)]
    return np.array([[own.get(name, 0.0) for own, names in agents for name in names]], np.float32)


SEEN = joint_of(
    {"v_deviation": -0.4, "q": 0.3, "r": 0.2, "x": 0.5, "p_ref_next": 0.615, "backlog": 0.0},
    {"v_deviation": 0.1, "q": -0.5, "r": 0.1, "x": 0.25},
    {"v_deviation": -0.9, "q": 0.9, "r": 0.3, "x": 0.02},
)


def test_the_fields_stand_where_the_tests_put_them():
    names = field_names(TOY6)
    assert names["dc_0"] == FIELDS
    assert names["inv_0"] == names["inv_1"] == FIELDS[:7]


def test_networks_of_single_agents_see_their_own_rows():
    found = PolicyInterface(TOY6, "shared").inputs(SEEN)
    np.testing.assert_array_equal(found["datacenter"], SEEN[:, None, :9])
    np.testing.assert_array_equal(found["inverter"], SEEN[:, 9:].reshape(1, 2, 7))
    np.testing.assert_array_equal(PolicyInterface(TOY6, "joint").inputs(SEEN)["joint"], SEEN)


def test_the_nameplate_by_hand():
    # r times MW, x times Mvar, and the deviation over the latter, cut to 3: -0.4 / 0.4125, 0.1 / 0.25, -0.9 / 0.02.
    plates = np.array([[0.5, 0.4125, -0.4 / 0.4125], [0.1, 0.25, 0.4], [0.3, 0.02, -3.0]])
    found = PolicyInterface(TOY6, "shared", nameplate=True).inputs(SEEN)
    np.testing.assert_allclose(found["datacenter"][0, :, 9:], plates[:1], rtol=1e-6)
    np.testing.assert_allclose(found["inverter"][0, :, 7:], plates[1:], rtol=1e-6)
    np.testing.assert_array_equal(found["inverter"][0, :, :7], SEEN[0, 9:].reshape(2, 7))
    joint = PolicyInterface(TOY6, "joint", nameplate=True).inputs(SEEN)["joint"]
    np.testing.assert_array_equal(joint[:, :23], SEEN)
    np.testing.assert_allclose(joint[0, 23:], plates.T.ravel(), rtol=1e-6)  # all draws, all reaches, all that is needed
    joint = joint_of({"v_deviation": 0.001}, {"v_deviation": 1.0}, {})
    without_x = PolicyInterface(TOY6, "shared", nameplate=True).inputs(joint)
    np.testing.assert_allclose(without_x["datacenter"][0, 0, 11], 1.0)  # an agent beside the substation reaches 0.001
    assert without_x["inverter"][0, 0, 9] == 3.0


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("nameplate", [False, True])
@pytest.mark.parametrize(
    "scenario",
    [
        TOY6,
        make_scenario("ieee123", observe="neighbours"),
        make_scenario("toy6", observe="feeder"),
        make_scenario("toy6", n_datacenters=0, datacenters={"buses": ()}),
        make_scenario("toy6", inverters={"buses": (), "s_rated_kva": ()}),
        make_scenario("toy6", datacenters={"clock_law": PrefillDecodeDvfs()}),
    ],
    ids=["local", "neighbours", "feeder", "no data centre", "no inverter", "work_classes"],
)
def test_widths_are_those_of_what_is_seen_and_done(scenario, kind, nameplate):
    view = PolicyInterface(scenario, kind, nameplate=nameplate, outputs="change")
    seen = TensorEnv(scenario, like=np.empty(0)).reset([1, 2])
    inputs = view.inputs(seen)
    assert {name: own.shape[-1] for name, own in inputs.items()} == {n: w[0] for n, w in view.widths.items()}
    outputs = {name: np.zeros((*own.shape[:-1], view.widths[name][1])) for name, own in inputs.items()}
    assert view.action(seen, outputs).shape == (2, 2 * scenario.datacenters.count + scenario.inverters.count)


def test_fields_of_the_coming_step_are_hidden_without_preview():
    view = PolicyInterface(TOY6, "shared", preview=False)
    hidden = SEEN.copy()
    hidden[:, 7] = 0.0
    np.testing.assert_array_equal(view.inputs(SEEN)["datacenter"][:, 0], hidden[:, :9])
    two_classes = make_scenario("toy6", datacenters={"clock_law": PrefillDecodeDvfs()})
    (seen,) = PolicyInterface(two_classes, "joint", preview=False).inputs(np.ones((1, 25), np.float32)).values()
    names = [name for own in field_names(two_classes).values() for name in own]
    assert [name for name, value in zip(names, seen[0], strict=True) if value == 0.0] == [
        "p_ref_next", "p_ref_next_compute",
    ]  # fmt: skip


# --- outputs --------------------------------------------------------------------------------------------------------

SHARED = {"datacenter": np.array([[[0.3, -0.2]]]), "inverter": np.array([[[0.1], [0.4]]])}
JOINT = {"joint": np.array([[0.3, -0.2, 0.1, 0.4]])}


@pytest.mark.parametrize(("kind", "outputs"), [("shared", SHARED), ("joint", JOINT)])
def test_setpoints_are_the_action(kind, outputs):
    np.testing.assert_array_equal(PolicyInterface(TOY6, kind).action(SEEN, outputs), JOINT["joint"])
    wide = {name: 10.0 * values for name, values in outputs.items()}
    np.testing.assert_array_equal(PolicyInterface(TOY6, kind).action(SEEN, wide), [[1.0, -1.0, 1.0, 1.0]])


@pytest.mark.parametrize(("kind", "outputs"), [("shared", SHARED), ("joint", JOINT)])
def test_changes_by_hand(kind, outputs):
    # p_ref_next 0.615 is 0.385 of work, half of the 0.77 that the top clock serves; half the top clock is an action of
    # 2 (0.5 - slowest) / (1 - slowest) - 1. The clock is held back by 0.3 from there. q is added to what stands.
    clock = 2.0 * (0.5 - SLOWEST) / (1.0 - SLOWEST) - 1.0
    found = PolicyInterface(TOY6, kind, outputs="change").action(SEEN, outputs)
    np.testing.assert_allclose(found, [[clock - 0.3, 0.3 - 0.2, -0.5 + 0.1, 1.0]], rtol=1e-6)
    negative = {name: -values for name, values in outputs.items()}
    hasty = PolicyInterface(TOY6, kind, outputs="change").action(SEEN, negative)
    np.testing.assert_allclose(hasty, [[clock, 0.3 + 0.2, -0.5 - 0.1, 0.9 - 0.4]], rtol=1e-6)  # never faster than that
    blind = PolicyInterface(TOY6, kind, outputs="change", preview=False).action(SEEN, outputs)
    np.testing.assert_allclose(blind[0, 0], 1.0 - 0.3)  # what is to come is unknown: from the top clock


@pytest.mark.parametrize(("kind", "outputs"), [("shared", SHARED), ("joint", JOINT)])
def test_corrections_of_the_droop_by_hand(kind, outputs):
    # A band is 0.05 p.u. At -0.4 of it k_p = 10 takes 0.2 MW or 0.08 of the rating off 0.615, k_q = 0.5 asks for 0.01
    # Mvar more, of 0.825; the inverters, at 0.1 and -0.9, for 0.0025 less and 0.0225 more, of 1.
    speed = (0.615 - 0.08 - 0.23) / 0.77
    clock = 2.0 * (speed - SLOWEST) / (1.0 - SLOWEST) - 1.0
    law = np.array([[clock, 0.3 + 0.01 / 0.825, -0.5 - 0.0025, 0.9 + 0.0225]])
    view = PolicyInterface(TOY6, kind, outputs="droop", gains=GAINS)
    np.testing.assert_allclose(view.action(SEEN, {n: 0.0 * v for n, v in outputs.items()}), law, rtol=1e-6)
    np.testing.assert_allclose(view.action(SEEN, outputs), np.minimum(law + JOINT["joint"], 1.0), rtol=1e-6)
    queue = joint_of({"p_ref_next": 0.3, "backlog": 0.5}, {}, {})  # 0.3 of the queue a second
    expected = 2.0 * ((0.3 + 0.15 - 0.23) / 0.77 - SLOWEST) / (1.0 - SLOWEST) - 1.0
    assert view.action(queue, {n: 0.0 * v for n, v in outputs.items()})[0, 0] == pytest.approx(expected, rel=1e-6)


@pytest.mark.parametrize("name", ["toy6", "ieee33-weak", "training", "robust"])
def test_without_corrections_it_is_the_droop_law(name):
    scenario = make_scenario(name, split="train", horizon=30)
    n_action = 2 * scenario.datacenters.count + scenario.inverters.count
    view, law = PolicyInterface(scenario, "joint", outputs="droop", gains=GAINS), Droop(*GAINS)
    law.reset(scenario)
    env = TensorEnv(scenario, like=np.empty(0))
    seen, low, high = env.reset(range(4)), *joint_bounds(scenario)
    while not env.over:
        seen = np.clip(seen, low, high)
        action = view.action(seen, {"joint": np.zeros((4, n_action))})
        np.testing.assert_allclose(action, law.act(seen), atol=1e-5)
        seen = env.step(action).observation


@pytest.mark.parametrize("name", ["toy6", "ieee33-weak", "training"])
def test_a_clock_that_is_not_held_back_queues_nothing_and_is_the_slowest_of_those(name):
    scenario = make_scenario(name, split="train", horizon=30)
    n_action = 2 * scenario.datacenters.count + scenario.inverters.count
    view, env = PolicyInterface(scenario, "joint", outputs="change"), TensorEnv(scenario, like=np.empty(0))
    seen, slower = env.reset(range(4)), False
    while not env.over:
        action = view.action(seen, {"joint": np.zeros((4, n_action))})
        clocks = slice(0, 2 * scenario.datacenters.count, 2)
        step = env.step(action)
        assert step.state.backlog_kws.max() < 1e-9
        busy = action[:, clocks] > -1.0
        unused = (
            step.state.served_kw
            - scenario.datacenters.parameters.p_dynamic_kw * step.state.f_mhz / scenario.datacenters.f_max_mhz
        )
        np.testing.assert_allclose(unused[busy], 0.0, atol=1e-9)
        slower, seen = slower or bool((action[:, clocks] < 0.9).any()), step.observation
    assert slower


def test_a_queue_is_served_at_once():
    # 0.4 s at the rating is queued and 0.27 arrives: 0.67 of the 0.77 that the top clock serves in a second.
    seen = joint_of({"p_ref_next": 0.5, "backlog": 0.4}, {}, {})
    speed = (0.5 - 0.23 + 0.4) / 0.77
    expected = 2.0 * (speed - SLOWEST) / (1.0 - SLOWEST) - 1.0
    still = {"joint": np.zeros((1, 4))}
    assert PolicyInterface(TOY6, "joint", outputs="change").action(seen, still)[0, 0] == pytest.approx(expected)
    short = make_scenario("toy6", dt_s=0.1)  # the same queue is ten times the work of one step
    assert PolicyInterface(short, "joint", outputs="change").action(seen, still)[0, 0] == 1.0


@pytest.mark.parametrize("outputs", OUTPUTS)
@pytest.mark.parametrize(("kind", "given"), [("shared", SHARED), ("joint", JOINT)])
def test_an_axis_that_is_not_in_hand_rests(kind, given, outputs):
    chosen = {"outputs": outputs, "gains": GAINS if outputs == "droop" else None}
    free = PolicyInterface(TOY6, kind, **chosen).action(SEEN, given)
    only_q = PolicyInterface(TOY6, kind, **chosen, act="q").action(SEEN, given)
    only_clock = PolicyInterface(TOY6, kind, **chosen, act="clock").action(SEEN, given)
    np.testing.assert_array_equal(only_q, [[1.0, *free[0, 1:]]])
    np.testing.assert_array_equal(only_clock, [[free[0, 0], 0.0, 0.0, 0.0]])


def tensors(array):
    return torch.tensor(np.array(array))


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("act", ["both", "q", "clock"])
@pytest.mark.parametrize("outputs", OUTPUTS)
def test_torch_sees_and_does_the_same(kind, act, outputs):
    scenario, rng = make_scenario("ieee33-weak", split="train"), np.random.default_rng(0)
    chosen = {"act": act, "outputs": outputs, "nameplate": True, "preview": act == "both"}
    chosen["gains"] = GAINS if outputs == "droop" else None
    one, other = PolicyInterface(scenario, kind, **chosen), PolicyInterface(scenario, kind, **chosen, array=tensors)
    seen = TensorEnv(scenario, like=np.empty(0, np.float32)).reset(range(3))
    mine, theirs = one.inputs(seen), other.inputs(torch.tensor(seen))
    assert mine.keys() == theirs.keys()
    given = {}
    for name, own in mine.items():
        np.testing.assert_allclose(theirs[name].numpy(), own, rtol=1e-6, atol=1e-7)
        given[name] = rng.normal(0.0, 0.5, (*own.shape[:-1], one.widths[name][1])).astype(np.float32)
    found = other.action(torch.tensor(seen), {name: torch.tensor(values) for name, values in given.items()})
    np.testing.assert_allclose(found.numpy(), one.action(seen, given), rtol=1e-6, atol=1e-6)


def test_leading_shapes_and_the_clip_that_is_given():
    seen, cuts = np.tile(SEEN, (2, 3, 1)), []

    def clip(x, low, high):
        cuts.append((low, high))
        return cut(x, low, high)

    given = {name: np.tile(values, (2, 3, *[1] * (values.ndim - 1))) for name, values in SHARED.items()}
    view = PolicyInterface(TOY6, "shared", outputs="change", nameplate=True, clip=clip)
    assert view.inputs(seen)["inverter"].shape == (2, 3, 2, 10)
    given = {name: values.reshape(2, 3, *values.shape[-2:]) for name, values in given.items()}
    action = view.action(seen, given)
    np.testing.assert_allclose(action, np.tile(view.action(SEEN, SHARED), (2, 3, 1)))
    assert cuts[:2] == [(0.0, 2.0), (-1.0, 1.0)]

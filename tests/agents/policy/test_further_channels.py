"""Policies of agents other than data centres and inverters, and of channels other than clock and reactive power."""

import numpy as np
import pytest
import torch

from dcgrid_env import DcgridVectorEnv, TensorEnv, action_layout, field_names, make_scenario, under_own_control
from dcgrid_env.agents import Network, Policy, PolicyError, guarded
from dcgrid_env.agents.policy.interface import KINDS, OUTPUTS, Gains, PolicyInterface, require_one_policy_fits
from helpers.forms import variant_of
from helpers.riding import ride_through_34
from helpers.storages import ieee33_weak_ups, toy6_storage

UPS = toy6_storage()  # a data centre, two inverters, two storages of 300 kW without reactive power
RIDING = ride_through_34(horizon=20)
GAINS = Gains(k_p_mw_per_pu=10.0, k_q_mvar_per_pu_s=0.5, alpha_per_s=0.3)


def random_network(n_in, n_out, seed=0):
    rng = np.random.default_rng(seed)
    return Network([(rng.normal(0.0, 0.3, (n_in, n_out)), rng.normal(0.0, 0.3, n_out))])


def policy_for(scenario, kind="shared", **settings):
    view = PolicyInterface(scenario, kind, nameplate=settings.get("nameplate", False))
    networks = {name: random_network(*widths) for name, widths in view.widths.items()}
    return Policy(networks, channels=view.further_channels, **settings)


def seen(scenario, n_env=3):
    return TensorEnv(scenario, like=np.empty(0, np.float32)).reset(range(n_env))


def test_a_policy_without_set_points_leaves_them_at_rest_and_one_with_them_chooses():
    scenario = variant_of("set points as agents")
    view, joint = PolicyInterface(scenario, "shared"), seen(scenario)
    assert view.further_channels["regulator_setpoint"] == ("offset", "half_band")
    is_offset = action_layout(scenario).is_channel("offset")
    for trained_on, rests in ((under_own_control(scenario), True), (scenario, False)):
        for kind in KINDS:
            policy = policy_for(trained_on, kind)
            policy.reset(scenario)
            offset = policy.act(joint)[:, is_offset]
            assert (np.abs(offset) < 1e-12).all() == rests, (kind, rests)


def test_a_network_for_each_kind_with_the_channels_of_its_device():
    assert PolicyInterface(UPS, "shared").widths == {"datacenter": (9, 2), "inverter": (7, 1), "storage": (10, 1)}
    assert PolicyInterface(UPS, "shared").further_channels == {"storage": ("p",)}
    (joint,) = PolicyInterface(UPS, "joint").further_channels.values()
    assert joint == ("clock", "q", "q", "q", "p", "p")
    assert PolicyInterface(RIDING, "shared").further_channels == {"datacenter": ("clock", "q", "return")}
    assert PolicyInterface(make_scenario("toy6"), "joint").further_channels == {}
    with_q = toy6_storage(figures={"s_rated_kva": 320.0})
    assert PolicyInterface(with_q, "shared").channels["storage"] == ("p", "q")


@pytest.mark.parametrize("outputs", OUTPUTS)
@pytest.mark.parametrize("kind", KINDS)
def test_a_further_channel_moves_from_its_rest(outputs, kind):
    for scenario, name, rest in ((UPS, "p", 0.0), (RIDING, "return", 1.0)):
        view = PolicyInterface(scenario, kind, outputs=outputs, gains=GAINS if outputs == "droop" else None)
        joint, at = seen(scenario), action_layout(scenario).is_channel(name)
        given = {
            own: np.full((*rows.shape[:-1], view.widths[own][1]), -0.4) for own, rows in view.inputs(joint).items()
        }
        expected = -0.4 if outputs == "setpoint" else rest - 0.4
        np.testing.assert_allclose(view.action(joint, given)[:, at], expected, rtol=1e-6)
        for act in ("q", "clock"):
            held = PolicyInterface(scenario, kind, outputs="setpoint", act=act).action(joint, given)
            np.testing.assert_allclose(held[:, at], rest)
            moved = action_layout(scenario).is_channel(act)
            np.testing.assert_allclose(held[:, moved], -0.4)


@pytest.mark.parametrize("scenario", [UPS, RIDING], ids=["storages", "riding"])
@pytest.mark.parametrize("outputs", OUTPUTS)
@pytest.mark.parametrize("kind", KINDS)
def test_tensors_do_the_same(scenario, outputs, kind):
    chosen = {"outputs": outputs, "nameplate": True, "gains": GAINS if outputs == "droop" else None}
    one = PolicyInterface(scenario, kind, **chosen)
    other = PolicyInterface(scenario, kind, **chosen, array=lambda array: torch.tensor(np.array(array)))
    joint, rng = seen(scenario), np.random.default_rng(0)
    mine, theirs = one.inputs(joint), other.inputs(torch.tensor(joint))
    given = {}
    for name, own in mine.items():
        np.testing.assert_allclose(theirs[name].numpy(), own, rtol=1e-5, atol=1e-6)
        given[name] = rng.normal(0.0, 0.5, (*own.shape[:-1], one.widths[name][1])).astype(np.float32)
    found = other.action(torch.tensor(joint), {name: torch.tensor(values) for name, values in given.items()})
    np.testing.assert_allclose(found.numpy(), one.action(joint, given), rtol=1e-6, atol=1e-6)


def test_without_reactive_power_the_nameplate_is_of_active_power():
    joint = seen(UPS)
    inputs = PolicyInterface(UPS, "shared", nameplate=True).inputs(joint)["storage"]
    fields = field_names(UPS)["sto_0"]
    v, r = (inputs[..., fields.index(name)] for name in ("v_deviation", "r"))
    np.testing.assert_allclose(inputs[..., len(fields)], 0.3 * r, rtol=1e-5)
    np.testing.assert_array_equal(inputs[..., len(fields) + 1], 0.0)
    np.testing.assert_allclose(inputs[..., len(fields) + 2], np.clip(v / (0.3 * r), -3.0, 3.0), rtol=1e-5)


def test_agents_of_a_kind_stand_wherever_their_devices_do():
    sites, inverters, storages = UPS.devices
    apart = UPS.replace(devices=(storages, inverters, sites))
    policy = policy_for(UPS)
    policy.reset(apart)
    joint = seen(apart)
    found = action_layout(apart).split(policy.act(joint))
    ends = np.cumsum([len(names) for names in field_names(apart).values()])
    rows = dict(zip(apart.agents, np.split(joint, ends[:-1], -1), strict=True))
    for agent, own in found.items():
        kind = {"dc": "datacenter", "inv": "inverter", "sto": "storage"}[agent.partition("_")[0]]
        np.testing.assert_allclose(own, np.clip(policy.networks[kind](rows[agent]), -1.0, 1.0), atol=1e-6)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("scenario", [UPS, RIDING], ids=["storages", "riding"])
def test_such_a_policy_comes_back_as_it_was_saved(tmp_path, scenario, kind):
    policy = policy_for(scenario, kind)
    found = Policy.load(policy.save(tmp_path / "policy"))
    assert (found.channels, found.sha256) == (policy.channels, policy.sha256)
    policy.reset(scenario)
    found.reset(scenario)
    np.testing.assert_array_equal(found.act(seen(scenario)), policy.act(seen(scenario)))


@pytest.mark.parametrize(
    ("name", "scenario", "message"),
    [
        (
            "ieee33-weak-ppo",
            ieee33_weak_ups(),
            "no network for agents of kind storage of ieee33-weak-ups, but .*; it was",
        ),
        (
            "ieee34-3ph-cem",
            RIDING,
            r"network datacenter takes 14 figures and gives 2, on ride-through \(.*\) it must be",
        ),
    ],
)
def test_a_policy_that_does_not_fit_says_what_and_what_to_do(name, scenario, message):
    with pytest.raises(PolicyError, match=rf"{name}: .*{message}.*; train one for this scenario"):
        Policy.load(name).reset(scenario)


def test_channels_of_other_names_are_refused():
    toy = make_scenario("toy6")
    turned = toy.replace(devices=toy.devices[::-1])
    plain = Policy({"joint": random_network(23, 4)})
    plain.reset(toy)
    with pytest.raises(PolicyError, match="network joint gives clock, q, q, q; on toy6 its agents take q, q, clock, q"):
        plain.reset(turned)
    policy_for(turned, "joint").reset(turned)
    other = Policy({**policy_for(UPS).networks, "storage": random_network(10, 1)}, channels={"storage": ["power"]})
    with pytest.raises(PolicyError, match=r"network storage gives power; on toy6-storage its agents take p; .*; train"):
        other.reset(UPS)
    with pytest.raises(ValueError, match=r"network 'storage' would .*2.* train on scenarios of the same agents"):
        require_one_policy_fits(
            [PolicyInterface(s, "shared") for s in (UPS, toy6_storage(figures={"s_rated_kva": 320.0}))]
        )


def test_constant_set_points_also_apply_under_the_guard_and_must_be_in_range():
    scenario = make_scenario("ieee13-3ph", horizon=3, grid_control={"regulators": "setpoint"})
    policy = Policy.load("ieee13-3ph-cem")
    policy.set_points = {"offset": {"reg1": -3.0}}
    sent = []
    for controller in (policy, guarded(policy)):
        env = DcgridVectorEnv(1, scenario)
        observations, _ = env.reset(seed=[0])
        controller.reset(scenario)
        action = controller.act(observations)
        sent.append(action[:, action_layout(scenario).is_channel("offset")])
    np.testing.assert_allclose(sent, -0.75)
    policy.set_points = {"offset": {"reg1": 100.0}}
    with pytest.raises(ValueError, match=r"set point of regset_0: offset is 100.0; give a number from -4 to 4"):
        policy.reset(scenario)

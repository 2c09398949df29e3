"""Saved policies: the file, the forward pass, and what is refused."""

import itertools
import json
import math
import subprocess
import sys
from typing import Any

import numpy as np
import pytest
from safetensors import safe_open
from safetensors.numpy import save_file

from dcgrid_env import DcgridEnv, field_names, make_scenario, parallel_env
from dcgrid_env.agents import Card, Network, Policy, PolicyError
from dcgrid_env.agents.policy.policy_file import KEY, digest
from dcgrid_env.baselines import rollout

RNG = np.random.default_rng(0)


def network(*widths, **settings):
    layers = [
        (RNG.normal(0.0, 0.3, (n_in, n_out)), RNG.normal(0.0, 0.3, n_out)) for n_in, n_out in itertools.pairwise(widths)
    ]
    return Network(layers, **settings)


def widths(scenario):
    env = DcgridEnv(scenario)
    return len(env.observation_space.sample()), len(env.action_space.sample())


def with_set_points(set_points: Any) -> Policy:
    return Policy({"joint": network(3, 2)}, set_points=set_points)


def around_constants(q_share: Any) -> Policy:
    return Policy({"joint": network(3, 2)}, outputs="constant", q_share=q_share)


def shared(**settings):
    return Policy(
        {"datacenter": network(9, 8, 2, **settings), "inverter": network(7, 8, 1, **settings)},
        scenario="toy6",
        made_with="python -m train",
    )


@pytest.mark.parametrize("settings", [{}, {"activation": "silu", "squash": "tanh", "clip": 5.0}])
def test_a_policy_comes_back_as_it_was_saved(tmp_path, settings):
    scenario = make_scenario("toy6", split="test", horizon=5)
    n_in, n_out = widths(scenario)
    kinds = {"mean": RNG.normal(size=n_in), "std": np.full(n_in, 0.5)} | settings
    joint = Policy({"joint": network(n_in, 16, 16, n_out, **kinds)}, preview=False, act="clock")
    plated = {"datacenter": network(12, 2, **settings), "inverter": network(10, 1, **settings)}
    corrects = {"nameplate": True, "outputs": "droop", "gains": [5.0, 0.5, 0.1]}
    plates = (Policy(plated, nameplate=True, act="q", outputs="change"), Policy(plated, **corrects))
    around = Policy(plated, nameplate=True, outputs="constant", q_share=[0.5, -0.25, 1.0])
    wide = Policy({"joint": network(n_in + 9, n_out, **settings)}, nameplate=True)
    for policy in (shared(**settings), joint, *plates, around, wide):
        path = policy.save(tmp_path / "new" / "policy")
        assert path == tmp_path / "new" / "policy.safetensors"
        found = Policy.load(path)
        settings_of_all = ("kind", "observe", "preview", "acts", "nameplate", "outputs", "gains", "q_share")
        for field in (*settings_of_all, "trained_on", "made_with", "sha256"):
            assert getattr(found, field) == getattr(policy, field)
        seen = RNG.normal(size=(4, n_in)).astype(np.float32)
        policy.reset(scenario)
        found.reset(scenario)
        assert found.act(seen).dtype == np.float32
        np.testing.assert_array_equal(found.act(seen), policy.act(seen))
        assert policy.save(tmp_path / "again").read_bytes() == path.read_bytes()
        assert sorted(file.name for file in path.parent.iterdir()) == ["policy.json", "policy.safetensors"]


def test_the_card_stands_beside_the_weights(tmp_path):
    path = shared().save(tmp_path / "p.safetensors", {"algorithm": "ppo", "seed": 3, "training_s": 2.5})
    card = Card.load(path.with_suffix(".json"))
    assert (card.scenario, card.command, card.algorithm, card.seed) == ("toy6", "python -m train", "ppo", 3)
    assert (card.training_s, card.validation_J, card.scored) == (2.5, None, None)
    assert card.n_parameters == 9 * 8 + 8 + 8 * 2 + 2 + 7 * 8 + 8 + 8 + 1
    assert card.sha256 == Policy.load(path).sha256 != shared().sha256
    with pytest.raises(PolicyError, match="card: time is no field of it; give some of algorithm, scenario"):
        shared().save(tmp_path / "other", {"time": 3.0})
    assert not list(tmp_path.glob("other*"))


@pytest.mark.filterwarnings("ignore::dcgrid_env.agents.UnseenScenarioWarning")
def test_shared_networks_act_for_each_agent_alone_on_any_feeder():
    policy = shared()
    for name in ("toy6", "ieee123"):
        scenario = make_scenario(name, split="test", horizon=3)
        many = parallel_env(scenario)
        observations, _ = many.reset(seed=1)
        policy.reset(scenario)
        actions = policy.act(observations)
        for agent, seen in observations.items():
            own = policy.networks["datacenter" if agent.startswith("dc_") else "inverter"](seen)
            assert actions[agent] == pytest.approx(own, abs=1e-6)
            assert many.action_space(agent).contains(actions[agent])
        joint = policy.act(np.concatenate(list(observations.values())))
        np.testing.assert_allclose(joint, np.concatenate(list(actions.values())), atol=1e-6)


def test_a_policy_drives_a_batch_and_gets_the_scope_that_it_was_trained_with():
    scenario = make_scenario("toy6", split="test", horizon=4)
    wide = scenario.replace(observe="feeder")
    policy = Policy({"joint": network(widths(wide)[0], 4, widths(wide)[1])}, observe="feeder")
    recorder = rollout(scenario, policy, range(3))
    assert [m["steps"] for m in recorder.metrics()] == [4.0] * 3


def test_zero_weights_act_like_the_bias():
    policy = Policy(
        {"datacenter": Network([(np.zeros((9, 2)), [1.0, 0.25])]), "inverter": Network([(np.zeros((7, 1)), [-0.5])])}
    )
    scenario = make_scenario("toy6", split="test")
    policy.reset(scenario)
    np.testing.assert_array_equal(policy.act(np.ones((2, widths(scenario)[0]))), [[1.0, 0.25, -0.5, -0.5]] * 2)


def test_a_policy_of_neighbours_runs_on_a_scenario_of_local_observations():
    wide = make_scenario("toy6", observe="neighbours")
    names = field_names(wide)
    policy = Policy(
        {"datacenter": network(len(names["dc_0"]), 2), "inverter": network(len(names["inv_0"]), 1)},
        observe="neighbours",
    )
    assert rollout(make_scenario("toy6", split="test", horizon=3), policy, [0]).metrics()[0]["steps"] == 3.0


def test_without_preview_the_coming_load_moves_nothing():
    scenario = make_scenario("toy6", split="test")
    n_in, n_out = widths(scenario)
    at = field_names(scenario)["dc_0"].index("p_ref_next")
    nets = {"datacenter": network(9, 4, 2), "inverter": network(7, 4, 1)}
    for networks in (nets, {"joint": network(n_in, 4, n_out)}):
        seen = RNG.normal(size=(2, n_in)).astype(np.float32)
        other = seen.copy()
        other[:, at] += 1.0
        sees, blind = Policy(networks), Policy(networks, preview=False)
        sees.reset(scenario)
        blind.reset(scenario)
        assert (sees.act(seen) != sees.act(other)).any()
        np.testing.assert_array_equal(blind.act(seen), blind.act(other))
        other[:, at] = 0.0
        np.testing.assert_array_equal(blind.act(seen), sees.act(other))


def test_an_axis_that_is_held_is_at_rest_whatever_the_network_says():
    scenario = make_scenario("toy6", split="test")  # one data centre, two inverters
    dc, inv = Network([(np.zeros((9, 2)), [-0.5, 0.25])]), Network([(np.zeros((7, 1)), [-0.75])])
    joint = Network([(np.zeros((23, 4)), [-0.5, 0.25, -0.75, -0.75])])
    expected = {"both": [-0.5, 0.25, -0.75, -0.75], "q": [1, 0.25, -0.75, -0.75], "clock": [-0.5, 0, 0, 0]}
    for act, action in expected.items():
        for networks in ({"datacenter": dc, "inverter": inv}, {"joint": joint}):
            policy = Policy(networks, act=act)
            policy.reset(scenario)
            np.testing.assert_array_equal(policy.act(np.ones((2, 23), np.float32)), [action] * 2)


def test_the_nameplate_worked_by_hand():
    # What an agent does is the sum of some of its three figures: draw and what is needed, or reach and what is needed.
    draw, reach, needed = (np.eye(3)[:, [i]] for i in range(3))
    of_site = np.concatenate((np.zeros((9, 2)), np.concatenate((draw + 0.1 * needed, reach), axis=1)))
    of_inverter = np.concatenate((np.zeros((7, 1)), 0.5 * reach + 0.2 * needed))
    policy = Policy(
        {"datacenter": Network([(of_site, [0.0, 0.0])]), "inverter": Network([(of_inverter, [0.0])])}, nameplate=True
    )
    scenario = make_scenario("toy6", split="test")  # 2.5 MW with 0.825 Mvar, and two inverters of 1 Mvar
    policy.reset(scenario)
    names, joint = field_names(scenario), np.zeros((1, 23), np.float32)
    given = {"dc_0": (-0.2, 0.1, 0.5), "inv_0": (0.3, 0.2, 0.4), "inv_1": (-0.9, 0.3, 0.01)}  # v_deviation, r, x
    first = 0
    for agent, figures in given.items():
        for field, value in zip(("v_deviation", "r", "x"), figures, strict=True):
            joint[0, first + names[agent].index(field)] = value
        first += len(names[agent])
    needed_dc = -0.2 / (0.5 * 0.825)
    expected = [0.1 * 2.5 + 0.1 * needed_dc, 0.5 * 0.825, 0.5 * 0.4 + 0.2 * 0.75, 0.5 * 0.01 - 0.2 * 3.0]
    np.testing.assert_allclose(policy.act(joint), [expected], rtol=1e-6)
    # A joint network has the draws of all agents, then the reaches, then what is needed.
    one_each = np.concatenate((np.zeros((23, 4)), np.zeros((9, 4))))
    one_each[23, 0] = one_each[26, 1] = one_each[30, 2] = one_each[31, 3] = 0.1
    wide = Policy({"joint": Network([(one_each, np.zeros(4))])}, nameplate=True)
    wide.reset(scenario)
    np.testing.assert_allclose(wide.act(joint), [[0.025, 0.04125, 0.075, -0.3]], rtol=1e-6)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Policy({}), "give joint alone, or one for each kind of agent"),
        (lambda: Policy({"joint": network(3, 2), "inverter": network(3, 1)}), "give joint alone"),
        (lambda: Policy({"a.b": network(3, 2)}), r"networks are \['a.b'\]; give joint alone, or one for each kind"),
        (lambda: Policy({"storage": network(3, 2)}, channels={"storage": ["p"]}), "the network gives 2: name"),
        (lambda: Policy({"storage": network(3, 2)}, channels={"site": ["p"]}), "the network is not there"),
        (lambda: Policy({"joint": network(3, 2)}, observe="all"), "observe is 'all'; choose one of local"),
        (lambda: Policy({"joint": network(3, 2)}, act="all"), "act is 'all'; choose one of both, clock, q"),
        (lambda: Policy({"joint": network(3, 2)}, preview=1), "preview is 1; give true or false"),  # pyright: ignore
        (lambda: Policy({"joint": network(3, 2)}, nameplate=1), "nameplate is 1; give true or false"),  # pyright: ignore
        (lambda: Policy({"joint": network(3, 2)}, outputs="step"), "outputs is 'step'; choose one of setpoint, change"),
        (lambda: Policy({"joint": network(3, 2)}, outputs="droop"), "gains are None and outputs 'droop'; give gains"),
        (lambda: Policy({"joint": network(3, 2)}, gains=[1.0, 1.0, 1.0]), "and outputs 'setpoint'; give gains with"),
        (lambda: Policy({"joint": network(3, 2)}, outputs="droop", gains=[1.0, -1.0, 1.0]), "each at least 0"),
        (lambda: Policy({"joint": network(3, 2)}, outputs="droop", gains=[1.0, 1.0]), "give k_p_mw_per_pu, k_q"),
        (lambda: Policy({"joint": network(3, 2)}, outputs="constant"), "q_share is None and outputs 'constant'; give"),
        (lambda: Policy({"joint": network(3, 2)}, q_share=[0.5]), "and outputs 'setpoint'; give q_share with constant"),
        *(
            (
                lambda value=value: around_constants(value),
                "give one number from -1 to 1 for each agent with reactive power",
            )
            for value in ([1.5], [math.nan], ["1"], [True], "abc", 0.5)
        ),
        *(
            (lambda value=value: with_set_points({"offset": {"reg1": value}}), "give a finite number")
            for value in (math.nan, 10**400, "1", True)
        ),
        *(
            (lambda value=value: with_set_points(value), "give a mapping from channels")
            for value in ([], 0, "abc", {"offset": "abc"}, {"offset": [["reg1", 1.0]]})
        ),
        (
            lambda: with_set_points({"offset_v": {"reg1": 1.0}}),
            "set_points have the channel 'offset_v'; choose from offset, half_band, centre, half_width",
        ),
        (lambda: shared().save("policy.pt"), r"policy.pt: a policy's file name ends in .safetensors"),
        (lambda: Policy.load("ieee124-analytic"), "no policy 'ieee124-analytic'; did you mean ieee123-analytic"),
    ],
)  # fmt: skip
def test_what_cannot_be_a_policy_is_named(make, message):
    with pytest.raises(PolicyError, match=message):
        make()


def rewritten(path, change):
    """A good policy's file with some of its contents changed, and the hash that belongs to them."""
    shared().save(path)
    with safe_open(path, framework="numpy") as file:
        arrays = {name: file.get_tensor(name).copy() for name in file.keys()}  # noqa: SIM118
        meta = json.loads(file.metadata()[KEY])
    change(arrays, meta)
    held = {key: value for key, value in meta.items() if key not in ("version", "sha256")}
    meta["sha256"] = digest(held, arrays)
    save_file(arrays, path, {KEY: json.dumps(meta)})


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda a, m: m.update(version=2), "version is 2, this dcgrid reads 1; export the policy again"),
        (lambda a, m: a.pop("inverter.w1"), "inverter: w1 is missing"),
        (lambda a, m: m.pop("observe"), "observe is missing"),
        (lambda a, m: m.pop("nameplate"), "nameplate is missing"),
        (lambda a, m: m.update(kind="joint"), "kind is 'joint', its networks are"),
        (lambda a, m: a["datacenter.w0"].__setitem__((0, 0), np.nan), r"datacenter: w0 holds nan; .* diverge"),
        (lambda a, m: a.update({"inverter.b0": np.ones((8, 1))}), r"inverter: b0 has shape \(8, 1\); give 1 dim"),
        (lambda a, m: a.update({"inverter.b0": np.zeros(3)}), r"inverter: w0 has shape \(7, 8\)"),
        (lambda a, m: a.update({"site.b0": np.zeros(3)}), "site.b0 belongs to none of its networks"),
        (lambda a, m: m["networks"]["inverter"].update(activation="x"), "inverter: activation is 'x'"),
        (lambda a, m: m["networks"]["inverter"].update(family="tree"), "inverter: family is 'tree', this dcgrid reads"),
        (lambda a, m: m["networks"]["inverter"].update(layers="2"), "policy.safetensors: "),
        (lambda a, m: m.update(networks=[]), "policy.safetensors: "),
    ],
)
def test_a_broken_file_is_named_with_its_field(tmp_path, change, message):
    path = tmp_path / "policy.safetensors"
    rewritten(path, change)
    with pytest.raises(PolicyError, match=message) as raised:
        Policy.load(path)
    assert str(path) in str(raised.value)


def test_what_is_no_policy_file_is_refused(tmp_path):
    path = tmp_path / "policy.safetensors"
    for content in (b"", b"PK\x03\x04 of a zip", b"hello", b"\xff" * 16):
        path.write_bytes(content)
        with pytest.raises(PolicyError, match=r"not a policy file; give one that Policy\.save"):
            Policy.load(path)
    save_file({"a": np.ones(3)}, path)
    with pytest.raises(PolicyError, match="not a policy file"):
        Policy.load(path)
    save_file({"a": np.ones(3)}, path, {KEY: "no JSON"})
    with pytest.raises(PolicyError, match="not a policy file"):
        Policy.load(path)
    with pytest.raises(OSError, match=r"nowhere\.safetensors"):
        Policy.load(tmp_path / "nowhere.safetensors")


def test_every_damage_to_a_file_is_a_policy_error_that_names_it(tmp_path):
    path = shared().save(tmp_path / "policy")
    whole = path.read_bytes()
    for at in range(0, len(whole), 7):
        path.write_bytes(whole[:at] + bytes([whole[at] ^ 1]) + whole[at + 1 :])
        with pytest.raises(PolicyError, match=r"policy\.safetensors: "):
            Policy.load(path)
    for n in range(0, len(whole), 40):
        path.write_bytes(whole[:n])
        with pytest.raises(PolicyError, match="not a policy file"):
            Policy.load(path)


def test_what_would_fill_the_memory_is_refused_before_it_is_read(tmp_path):
    path = tmp_path / "policy.safetensors"
    with path.open("wb") as file:
        file.truncate(300 * 2**20)
    with pytest.raises(PolicyError, match=r"policy\.safetensors: has 300 MiB; give a policy of at most 256 MiB"):
        Policy.load(path)


def test_writing_that_fails_leaves_what_was_there(tmp_path, monkeypatch):
    path = shared().save(tmp_path / "policy")
    before = path.read_bytes()

    def full(self, target):
        raise OSError(28, "No space left on device", str(target))

    monkeypatch.setattr(type(path), "replace", full)
    with pytest.raises(OSError, match="No space left"):
        shared(activation="relu").save(path)
    assert path.read_bytes() == before
    assert sorted(file.name for file in tmp_path.iterdir()) == ["policy.json", "policy.safetensors"]


def test_what_does_not_fit_a_scenario_is_refused_with_both_widths(tmp_path):
    toy = make_scenario("toy6")
    path = Policy({"joint": network(*widths(toy))}, scenario="toy6").save(tmp_path / "joint")
    with pytest.raises(
        PolicyError,
        match=r"joint\.safetensors: network joint takes 23 figures and gives 4, on ieee123 \(5 of kind "
        r"datacenter, 7 of kind inverter, local observation\) it must be 94 and 17; it was trained on toy6",
    ):
        Policy.load(path).reset(make_scenario("ieee123"))
    with pytest.raises(PolicyError, match="has no network for agents of kind inverter of toy6, but datacenter; "):
        Policy({"datacenter": network(9, 2)}).reset(toy)
    with pytest.raises(PolicyError, match="trained with observe='local', given 'feeder'"):
        shared().reset(toy.replace(observe="feeder"))


@pytest.mark.slow
def test_reading_and_running_a_policy_needs_no_torch(tmp_path):
    path = shared().save(tmp_path / "policy")
    code = (
        "import sys; from dcgrid_env.agents import Policy; from dcgrid_env import make_scenario\n"
        "p = Policy.load(sys.argv[1]); p.reset(make_scenario('toy6'))\n"
        "print([m for m in ('torch', 'stable_baselines3') if m in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code, str(path)], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"

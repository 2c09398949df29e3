"""Saved policies: the file, the forward pass, and what is refused."""

import itertools
import json
import subprocess
import sys
import zipfile

import numpy as np
import pytest

from dcgrid_env import DcgridEnv, make_scenario, parallel_env
from dcgrid_env.baselines import rollout
from dcgrid_env.baselines.policy import Network, Policy, PolicyError, load_policy, save_policy

RNG = np.random.default_rng(0)


def network(*widths, **settings):
    layers = [
        (RNG.normal(0.0, 0.3, (n_in, n_out)), RNG.normal(0.0, 0.3, n_out)) for n_in, n_out in itertools.pairwise(widths)
    ]
    return Network(layers, **settings)


def widths(scenario):
    env = DcgridEnv(scenario)
    return len(env.observation_space.sample()), len(env.action_space.sample())


def shared(**settings):
    return Policy(
        {"datacenter": network(9, 8, 2, **settings), "inverter": network(7, 8, 1, **settings)},
        scenario="toy6",
        made_with="python -m train",
    )


def test_a_forward_pass_worked_by_hand():
    layers = [([[1.0, -2.0], [0.5, 0.25]], [0.5, 0.0]), ([[2.0], [-1.0]], [0.1])]
    seen = np.array([3.0, 2.0])
    # (3 - 1) / 2 = 1, (2 - 0) / 0.5 = 4 cut to 3; layer: 1 + 1.5 + 0.5 = 3, -2 + 0.75 = -1.25; relu: 3, 0; 6 + 0.1.
    known = {"mean": [1.0, 0.0], "std": [2.0, 0.5], "clip": 3.0}
    assert Network(layers, "relu", "clip", **known)(seen) == [1.0]
    assert Network(layers, "relu", "tanh", **known)(seen) == pytest.approx([np.tanh(6.1)])
    small = [(np.array(w) / 10.0, np.array(b) / 10.0) for w, b in layers]
    # 0.3, -0.125 before the activation; out is 0.2 f(0.3) - 0.1 f(-0.125) + 0.01.
    for name, f in {
        "tanh": np.tanh,
        "relu": lambda x: max(x, 0.0),
        "elu": lambda x: x if x > 0 else np.exp(x) - 1.0,
        "silu": lambda x: x / (1.0 + np.exp(-x)),
    }.items():
        expected = 0.2 * f(0.3) - 0.1 * f(-0.125) + 0.01
        assert Network(small, name, **known)(seen) == pytest.approx([expected], rel=1e-6)


def test_activations_of_large_figures_are_finite():
    for name in ("tanh", "relu", "elu", "silu"):
        with np.errstate(over="raise", invalid="raise"):
            out = Network([([[1.0]], [0.0]), ([[1e-30]], [0.0])], name)(np.array([[1e5], [-1e5]]))
        assert np.isfinite(out).all()


@pytest.mark.parametrize("settings", [{}, {"activation": "silu", "squash": "tanh", "clip": 5.0}])
def test_a_policy_comes_back_as_it_was_saved(tmp_path, settings):
    scenario = make_scenario("toy6", split="test", horizon=5)
    n_in, n_out = widths(scenario)
    kinds = {"mean": RNG.normal(size=n_in), "std": np.full(n_in, 0.5)} | settings
    for policy in (shared(**settings), Policy({"joint": network(n_in, 16, 16, n_out, **kinds)}, observe="local")):
        path = tmp_path / "new" / "policy.npz"
        save_policy(path, policy)
        found = load_policy(path)
        assert (found.kind, found.observe, found.trained_on, found.made_with) == (
            policy.kind, policy.observe, policy.trained_on, policy.made_with,
        )  # fmt: skip
        seen = RNG.normal(size=(4, n_in)).astype(np.float32)
        policy.reset(scenario)
        found.reset(scenario)
        assert found.act(seen).dtype == np.float32
        np.testing.assert_array_equal(found.act(seen), policy.act(seen))
        assert not list(tmp_path.rglob("*.part"))
    with np.load(path, allow_pickle=False) as file:
        assert {"joint.w0", "joint.b2", "joint.mean", "meta"} < set(file.files)
        assert json.loads(file["meta"].tobytes())["format"] == "dcgrid policy"


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


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Network([]), "layers is empty"),
        (lambda: network(3, 2, activation="sigmoid"), "activation is 'sigmoid'; choose one of tanh, relu, elu, silu"),
        (lambda: network(3, 2, squash="none"), "squash is 'none'; choose one of clip, tanh"),
        (lambda: network(3, 2, clip=0.0), "clip is 0.0; give a number above 0"),
        (lambda: Network([(np.ones((3, 2)), np.ones(3))]), r"w0 has shape \(3, 2\); with 3 inputs and b0"),
        (lambda: Network([(np.ones((3, 2)), np.ones(2)), (np.ones((3, 1)), [0.0])]), r"w1 has shape \(3, 1\)"),
        (lambda: Network([(np.ones(3), np.ones(3))]), r"w0 has shape \(3,\); give 2 dimensions"),
        (lambda: Network([([[np.nan]], [0.0])]), r"w0 holds nan; give finite numbers"),
        (lambda: Network([([["a"]], [0.0])]), "w0 is no array of real numbers; give float32"),
        (lambda: Network([([[1j]], [0.0])]), "w0 is no array of real numbers; give float32"),
        (lambda: Network([([[1e300]], [0.0])]), "w0 holds inf; give finite numbers"),
        (lambda: network(3, 2, mean=[0.0, 0.0]), r"mean has shape \(2,\); give one figure for each of 3 inputs"),
        (lambda: network(3, 2, std=[1.0, 0.0, 1.0]), "std is 0.0 somewhere; give figures above 0"),
        (lambda: Policy({}), "give joint alone, or datacenter, inverter or both"),
        (lambda: Policy({"joint": network(3, 2), "inverter": network(3, 1)}), "give joint alone"),
        (lambda: Policy({"inverter": network(3, 2)}), "inverter: the network has 2 outputs; its agents take 1"),
        (lambda: Policy({"joint": network(3, 2)}, observe="all"), "observe is 'all'; choose one of local"),
        (lambda: save_policy("policy.pt", shared()), r"policy.pt: a policy's file name ends in .npz"),
    ],
)  # fmt: skip
def test_what_cannot_be_a_policy_is_named(make, message):
    with pytest.raises(PolicyError, match=message):
        make()


def rewritten(path, change):
    """A good policy's file with some of its contents changed."""
    save_policy(path, shared())
    with np.load(path) as file:
        arrays = {name: file[name] for name in file.files}
    meta = json.loads(arrays["meta"].tobytes())
    change(arrays, meta)
    arrays["meta"] = np.frombuffer(json.dumps(meta).encode(), np.uint8)
    np.savez(path, **arrays)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda a, m: m.update(version=2), "version is 2, this dcgrid reads 1; export the policy again"),
        (lambda a, m: m.update(format="other"), "not a policy file"),
        (lambda a, m: a.pop("inverter.w1"), "inverter.w1 is missing"),
        (lambda a, m: m.pop("observe"), "observe is missing"),
        (lambda a, m: m.update(kind="joint"), "kind is 'joint', its networks are"),
        (lambda a, m: a["datacenter.w0"].__setitem__((0, 0), np.inf), "datacenter: w0 holds inf"),
        (lambda a, m: a.update({"inverter.b0": np.full(8, 1j)}), "inverter: b0 is no array of real numbers"),
        (lambda a, m: a.update({"inverter.b0": np.zeros(3)}), r"inverter: w0 has shape \(7, 8\)"),
        (lambda a, m: m["networks"]["inverter"].update(activation="x"), "inverter: activation is 'x'"),
        (lambda a, m: m["networks"]["inverter"].update(layers="2"), "policy.npz: "),
        (lambda a, m: m.update(networks=[]), "policy.npz: "),
    ],
)
def test_a_broken_file_is_named_with_its_field(tmp_path, change, message):
    path = tmp_path / "policy.npz"
    rewritten(path, change)
    with pytest.raises(PolicyError, match=message) as raised:
        load_policy(path)
    assert str(path) in str(raised.value)


def test_what_is_no_policy_file_is_refused_and_no_pickle_is_loaded(tmp_path):
    path = tmp_path / "policy.npz"
    for content in (b"", b"PK\x03\x04 cut short", b"hello"):
        path.write_bytes(content)
        with pytest.raises(PolicyError, match="not a policy file; give one that save_policy wrote"):
            load_policy(path)
    np.savez(path, a=np.ones(3))
    with pytest.raises(PolicyError, match="not a policy file"):
        load_policy(path)
    np.savez(path, meta=np.array([{"format": "dcgrid policy"}], dtype=object), allow_pickle=True)
    with pytest.raises(PolicyError, match="not a policy file"):
        load_policy(path)
    with pytest.raises(OSError, match=r"nowhere\.npz"):
        load_policy(tmp_path / "nowhere.npz")


def test_every_damage_to_a_file_is_a_policy_error_that_names_it(tmp_path):
    path = tmp_path / "policy.npz"
    save_policy(path, shared())
    whole = path.read_bytes()
    told = set()
    for at in range(0, len(whole), 7):
        for value in (0, whole[at] ^ 1):
            path.write_bytes(whole[:at] + bytes([value]) + whole[at + 1 :])
            try:
                load_policy(path)
            except PolicyError as error:
                told.add(str(error))
    for n in range(0, len(whole), 40):
        path.write_bytes(whole[:n])
        with pytest.raises(PolicyError, match="not a policy file"):
            load_policy(path)
    assert f"{path}: not a policy file; give one that save_policy wrote" in told
    assert all(text.startswith(f"{path}: ") for text in told)


@pytest.mark.parametrize(
    ("field", "value"),
    [("flag_bits", 1), ("compress_type", 97), ("compress_type", 12), ("compress_type", 14)],
)
def test_a_way_of_packing_that_cannot_be_read_is_no_policy(tmp_path, field, value):
    path = tmp_path / "policy.npz"
    save_policy(path, shared())
    content = bytearray(path.read_bytes())
    for signature, offset in (
        (b"PK\x03\x04", {"flag_bits": 6, "compress_type": 8}),
        (b"PK\x01\x02", {"flag_bits": 8, "compress_type": 10}),
    ):
        at = content.find(signature)
        while at >= 0:
            content[at + offset[field]] = value
            at = content.find(signature, at + 4)
    path.write_bytes(content)
    with pytest.raises(PolicyError, match="not a policy file; give one that save_policy wrote") as raised:
        load_policy(path)
    assert str(path) in str(raised.value)


def test_what_would_fill_the_memory_is_refused_before_it_is_unpacked(tmp_path, monkeypatch):
    path = tmp_path / "policy.npz"
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as packed:
        for i in range(3):
            with packed.open(f"w{i}.npy", "w") as file:
                for _ in range(100):
                    file.write(bytes(2**20))
    monkeypatch.setattr(np, "load", lambda *a, **k: pytest.fail("it was unpacked"))
    assert path.stat().st_size < 2**20
    with pytest.raises(PolicyError, match=r"policy\.npz: unpacks to 300 MiB; give a policy of at most 256 MiB"):
        load_policy(path)


def test_what_does_not_fit_a_scenario_is_refused_with_both_widths(tmp_path):
    path = tmp_path / "joint.npz"
    toy = make_scenario("toy6")
    save_policy(path, Policy({"joint": network(*widths(toy))}, scenario="toy6"))
    with pytest.raises(
        PolicyError, match=r"joint\.npz: network joint takes 23 figures and gives 4, on ieee123 it must"
    ):
        load_policy(path).reset(make_scenario("ieee123"))
    with pytest.raises(PolicyError, match="has no network for the inverters of toy6"):
        Policy({"datacenter": network(9, 2)}).reset(toy)
    with pytest.raises(PolicyError, match="trained with observe='local', given 'feeder'"):
        shared().reset(toy.replace(observe="feeder"))


def test_reading_and_running_a_policy_needs_no_torch(tmp_path):
    save_policy(tmp_path / "policy.npz", shared())
    code = (
        "import sys; from dcgrid_env.baselines.policy import load_policy; from dcgrid_env import make_scenario\n"
        "p = load_policy(sys.argv[1]); p.reset(make_scenario('toy6')); print('torch' in sys.modules)"
    )
    done = subprocess.run(
        [sys.executable, "-c", code, str(tmp_path / "policy.npz")], capture_output=True, text=True, check=True
    )
    assert done.stdout.strip() == "False"

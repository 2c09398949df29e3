"""Models of Stable-Baselines3 from zip to policy: the actions are SB3's, and nothing is unpickled on the way."""

import base64
import io
import json
import pickle
import zipfile
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest
import torch
from stable_baselines3 import A2C, DDPG, PPO, SAC, TD3
from stable_baselines3.common.torch_layers import FlattenExtractor
from stable_baselines3.common.vec_env import VecNormalize

import dcgrid_env
from dcgrid_env.agents import Card, Network, Policy, PolicyError, ppo_settings, sac_settings, sb3_vec_env, to_policy
from dcgrid_env.agents.from_sb3.sb3_controller import trusted
from dcgrid_env.agents.from_sb3.sb3_policy import Normalisation, UnknownNormalisationWarning
from dcgrid_env.agents.from_sb3.sb3_zip import read_actor
from dcgrid_env.agents.training.row_form import RowForm
from dcgrid_env.agents.training.row_views import make_rows
from dcgrid_env.baselines import find_controller
from dcgrid_env.cli.main import main
from helpers.storages import toy6_storage

SCENARIO = "toy6"
SMALL: dict[str, Any] = {"net_arch": {"pi": [8, 6], "vf": [4]}}
ON_POLICY: dict[str, Any] = {"device": "cpu", "n_steps": 4, "seed": 3}
OFF_POLICY: dict[str, Any] = {"device": "cpu", "buffer_size": 10, "seed": 3}


class Marked:
    """Its unpickling leaves a file."""

    def __init__(self, path):
        self.path = path

    def __reduce__(self):
        return Path.touch, (self.path,)


class Doubled(FlattenExtractor):
    """An extractor without a weight, which the weights therefore do not show."""

    def forward(self, observations):
        return 2.0 * super().forward(observations)


def joint_env():
    return gymnasium.make("dcgrid/Toy6-v0", horizon=3)


def spread(model):
    """The model with larger weights, so that actions differ and some leave the range."""
    with torch.no_grad():
        for parameter in model.policy.parameters():
            parameter.mul_(2.0).add_(0.1 * torch.randn_like(parameter))
    return model


def made(kind, **settings: Any):
    own: dict[str, Any] = {"policy_kwargs": {"net_arch": [8, 6]}} | OFF_POLICY
    if kind in (PPO, A2C):
        own = {"policy_kwargs": dict(SMALL)} | ON_POLICY | ({"batch_size": 4} if kind is PPO else {})
    torch.manual_seed(0)
    return spread(kind("MlpPolicy", joint_env(), **(own | settings)))


def observations():
    env = gymnasium.make_vec("dcgrid/Toy6-v0", num_envs=4)
    observed = [env.reset(seed=0)[0]]
    rng = np.random.default_rng(0)
    for _ in range(3):
        observed.append(env.step(rng.uniform(-1.0, 1.0, env.action_space.shape).astype(np.float32))[0])
    return np.concatenate(observed)


def exported(zip_file, tmp_path, *options):
    main(["export-sb3", str(zip_file), "--scenario", SCENARIO, "--out", str(tmp_path / "policy"), *options])
    return Policy.load(tmp_path / "policy.safetensors")


def stopped(capsys, *arguments):
    with pytest.raises(SystemExit) as raised:
        main(list(arguments))
    said = capsys.readouterr().err
    assert (raised.value.code, len(said.splitlines())) == (2, 1)
    return said


SQUASHED = {"use_sde": True, "policy_kwargs": SMALL | {"squash_output": True}}
ELU = {"policy_kwargs": SMALL | {"activation_fn": torch.nn.ELU}}


@pytest.mark.parametrize(
    ("kind", "settings"),
    [(PPO, {}), (PPO, ELU), (PPO, SQUASHED), (A2C, {}), (SAC, {}), (TD3, {}), (DDPG, {})],
    ids=["ppo", "elu", "squashed", "a2c", "sac", "td3", "ddpg"],
)
def test_actions_are_those_of_predict(kind, settings, tmp_path):
    model = made(kind, **settings)
    model.save(tmp_path / "model")
    policy = exported(tmp_path / "model.zip", tmp_path)
    policy.reset(dcgrid_env.make_scenario(SCENARIO))
    seen = observations()
    expected = model.predict(seen, deterministic=True)[0]
    assert np.ptp(expected) > 0.5
    np.testing.assert_allclose(policy.act(seen), expected, atol=2e-6)
    card = Card.load(tmp_path / "policy.json")
    assert (card.algorithm, card.seed, card.scenario) == (f"sb3-{kind.__name__.lower()}", 3, SCENARIO)


FORMS = {"joint": {"outputs": "change"}, "shared": {"outputs": "setpoint", "nameplate": True}, "channel": {}}
"""Action forms by view; those of the view "channel" are the default, corrections of the tuned droop."""


def trained(kind: Any, view: Any, scenario: Any = SCENARIO):
    """Return a model after a few steps on rows of a view, which scales its observations itself."""
    envs = sb3_vec_env(scenario, 2, view, **FORMS[view])
    envs.seed(0)
    suited = ppo_settings(envs) if kind in (PPO, A2C) else sac_settings(envs)
    own: dict[str, Any] = {"policy_kwargs": suited["policy_kwargs"] | {"net_arch": [8, 6]}}
    own |= ON_POLICY if kind in (PPO, A2C) else OFF_POLICY | {"learning_starts": 2}
    own |= {"batch_size": 4} if kind is PPO else {}
    torch.manual_seed(0)
    model = kind("MlpPolicy", envs, **own)
    return spread(spread(model.learn(4 * envs.num_envs)))


def assert_acts_as(policy, model, envs, scenario, joint, atol=2e-6):
    """Assert that a policy's actions are those of ``predict`` on the rows of joint observations."""
    seen = []

    def predict(rows):
        seen.append(model.predict(envs.normalize_obs(rows) if envs else rows, deterministic=True)[0])
        return seen[-1]

    rows = make_rows(scenario, RowForm.read(model.action_space.form))
    expected = rows.driven(joint, predict)
    assert np.ptp(seen[0]) > 0.5
    policy.reset(scenario)
    np.testing.assert_allclose(policy.act(joint), expected, atol=atol)


@pytest.mark.parametrize("view", FORMS)
@pytest.mark.parametrize("kind", [PPO, A2C, SAC, TD3, DDPG])
def test_a_zip_of_rows_is_a_controller(kind, view, tmp_path):
    model, scenario = trained(kind, view), dcgrid_env.make_scenario(SCENARIO, split="test")
    model.save(tmp_path / "model")
    policy = find_controller(str(tmp_path / "model.zip"), scenario)
    assert isinstance(policy, Policy)
    assert policy.trained_on == SCENARIO
    assert_acts_as(policy, model, None, scenario, observations())
    kept = Policy.load(to_policy(model).save(tmp_path / "policy"))
    kept.reset(scenario)
    np.testing.assert_array_equal(kept.act(observations()), policy.act(observations()))


@pytest.mark.parametrize("view", ["shared", "channel"])
def test_rows_of_agents_with_further_channels(view):
    scenario = toy6_storage(4)
    model = trained(PPO, view, scenario)
    native = dcgrid_env.DcgridVectorEnv(4, scenario)
    joint, _ = native.reset(seed=0)
    policy = to_policy(model, scenario)
    assert policy.networks["storage"].n_out == 1
    assert_acts_as(policy, model, None, scenario, joint)
    with pytest.raises(PolicyError, match="it names no scenario of dcgrid list; give the scenario"):
        to_policy(model)


@pytest.mark.parametrize("view", FORMS)
@pytest.mark.parametrize("scaled", [False, True], ids=["alone", "before scaled observations"])
def test_vecnormalize_becomes_part_of_a_policy(view, scaled, tmp_path, capsys):
    rows = sb3_vec_env(SCENARIO, 2, view, horizon=4, **FORMS[view])
    envs = VecNormalize(rows, clip_obs=1.5)
    envs.seed(0)
    kwargs = ppo_settings(rows)["policy_kwargs"] if scaled else dict(SMALL)
    model = spread(PPO("MlpPolicy", envs, policy_kwargs=kwargs, batch_size=4, **ON_POLICY).learn(24))
    model.save(tmp_path / "model")
    envs.save(str(tmp_path / "rows.pkl"))
    file, pkl = str(tmp_path / "model.zip"), str(tmp_path / "rows.pkl")
    remedy = "convert it with `dcgrid export-sb3 --normalize FILE.pkl --trust`"
    for command in (("export-sb3", file), ("evaluate", file), ("evaluate", file, "--trust")):
        assert remedy in stopped(capsys, *command)
    assert "must be trusted, got the pickle file" in stopped(capsys, "export-sb3", file, "--normalize", pkl)
    scenario = dcgrid_env.make_scenario(SCENARIO)
    out = ("--out", str(tmp_path / "policy"))
    main(["export-sb3", file, "--normalize", pkl, "--trust", *out])
    for policy in (Policy.load(tmp_path / "policy.safetensors"), to_policy(model)):
        assert_acts_as(policy, model, envs, scenario, observations(), atol=2e-5)
    with pytest.raises(PolicyError, match="normalize has 3 figures and the observation"):
        Normalisation(np.zeros(3), np.ones(3), 10.0).before(Network([(np.zeros((2, 1)), [0.0])]))


def test_nothing_is_unpickled_without_trust(tmp_path, capsys):
    mark, model = tmp_path / "mark", str(tmp_path / "model.zip")
    trained(PPO, "channel").save(tmp_path / "plain")
    rewritten(tmp_path / "plain.zip", tmp_path / "model.zip", lambda about: about | {"lr_schedule": pickled(mark)})
    main(["export-sb3", model, "--out", str(tmp_path / "policy")])
    main(["evaluate", model, "--episodes", "2", "--out", str(tmp_path)])
    assert f"{SCENARIO}, test split" in capsys.readouterr().out
    assert not mark.exists()


@pytest.mark.parametrize(
    ("form", "said"),
    [
        ({"scenario": "{code}"}, "names no scenario of dcgrid list; add --scenario"),
        ({"view": "agent"}, "form has view 'agent'; it must be one of joint, shared, channel"),
        ({"view": "x" * 10_000}, "form has view 'xxxxxxxxxxxx...xxxxxxxxxxxxx'; it must be one of"),
        ({"nameplate": 1.0}, "form has nameplate 1.0; it must be one of True, False"),
        ({"gains": [1.0, 1e400, 0.0]}, "form has gains"),
        ({"gains": [1, 10**400, 0]}, "form has gains"),
        ({"gains": [1.0, 1.0, 1.0]}, "form has gains exactly if its outputs are 'droop'"),
        ({"view": "joint", "nameplate": False}, "observation and action have 15 and 1 figures; on toy6 they have"),
        ({"more": 1}, "form must have the fields view, outputs, nameplate, gains, scenario"),
    ],
)
def test_a_form_is_checked_and_runs_no_code(form, said, tmp_path, capsys):
    mark = tmp_path / "mark"
    (tmp_path / "own.py").write_text(f"open({str(mark)!r}, 'w')\n")
    form = {name: f"{tmp_path}/own.py:make" if value == "{code}" else value for name, value in form.items()}
    trained(PPO, "channel").save(tmp_path / "plain")

    def change(about):
        return about | {"action_space": about["action_space"] | {"form": about["action_space"]["form"] | form}}

    rewritten(tmp_path / "plain.zip", tmp_path / "model.zip", change)
    file = str(tmp_path / "model.zip")
    assert said in stopped(capsys, "export-sb3", file, "--out", str(tmp_path / "policy"))
    stopped(capsys, "evaluate", file, "--episodes", "2")
    assert not list(tmp_path.glob("policy*"))
    assert not mark.exists()


def test_weights_that_are_more_than_weights_are_refused(tmp_path, capsys):
    mark = tmp_path / "mark"
    made(PPO).save(tmp_path / "plain")
    written = io.BytesIO()
    torch.save({"action_net.weight": Marked(mark)}, written)
    rewritten(tmp_path / "plain.zip", tmp_path / "model.zip", lambda about: about, written.getvalue())
    said = stopped(capsys, "export-sb3", str(tmp_path / "model.zip"), "--scenario", SCENARIO)
    assert "policy.pth cannot be read as weights alone" in said
    assert not mark.exists()


def test_a_small_file_cannot_fill_the_memory(tmp_path, capsys):
    made(PPO).save(tmp_path / "plain")
    views, written = torch.zeros(1).expand(2**27), io.BytesIO()
    torch.save({"action_net.weight": views}, written)  # 512 MiB of one stored figure
    rewritten(tmp_path / "plain.zip", tmp_path / "views.zip", lambda about: about, written.getvalue())
    with zipfile.ZipFile(tmp_path / "plain.zip") as old, zipfile.ZipFile(tmp_path / "bzip2.zip", "w") as new:
        for name in old.namelist():
            new.writestr(name, old.read(name), zipfile.ZIP_BZIP2)
    for name, message in (("views", "weights of more than 256 MiB"), ("bzip2", "is compressed in another way")):
        said = stopped(capsys, "export-sb3", str(tmp_path / f"{name}.zip"), "--scenario", SCENARIO)
        assert message in said


def pickled(mark):
    """Return SB3's entry for an object that JSON cannot represent; loading this one leaves a mark."""
    return {":type:": "<class 'object'>", ":serialized:": base64.b64encode(pickle.dumps(Marked(mark))).decode()}


def rewritten(source, target, change, weights=None):
    """Copy a zip file with other ``data`` or other weights."""
    with zipfile.ZipFile(source) as old, zipfile.ZipFile(target, "w") as new:
        for name in old.namelist():
            content = old.read(name)
            if name == "data":
                content = json.dumps(change(json.loads(content))).encode()
            new.writestr(name, weights if weights and name == "policy.pth" else content)


def test_a_custom_extractor_is_refused_by_name_and_driven_where_trusted(tmp_path, capsys):
    model = made(PPO, policy_kwargs=SMALL | {"features_extractor_class": Doubled})
    model.save(tmp_path / "model")
    said = stopped(capsys, "export-sb3", str(tmp_path / "model.zip"), "--scenario", SCENARIO)
    assert "features_extractor_class is <class '" in said
    assert "controller class of some ten lines (docs/own-policy.md)" in said

    controller = trusted(tmp_path / "model.zip")
    controller.reset(dcgrid_env.make_scenario(SCENARIO))
    seen = observations()
    np.testing.assert_array_equal(controller.act(seen), model.predict(seen, deterministic=True)[0])


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"policy_kwargs": {"activation_fn": "<class 'torch.nn.modules.activation.GELU'>"}}, "activation_fn is"),
        ({"policy_kwargs": {"dropout": 0.1}}, "policy_kwargs: dropout is not known"),
        ({"policy_class": {"__module__": "mine"}}, "policy_class is one of mine"),
        ({"action_space": {":type:": "<class 'gymnasium.spaces.box.Box'>", "low": "[0. -1.]", "high": "[1. 1.]"}},
         "action_space: low is"),
        ({"observation_space": {":type:": "<class 'gymnasium.spaces.dict.Dict'>"}}, "observation_space is"),
        ({"cg_max_steps": 5}, "algorithm is none of ppo, a2c"),
        ({"policy_class": None}, "data is not what Stable-Baselines3 writes"),
    ],
)  # fmt: skip
def test_what_a_policy_cannot_express_is_refused_by_name(change, said, tmp_path):
    made(PPO).save(tmp_path / "plain")
    rewritten(tmp_path / "plain.zip", tmp_path / "model.zip", lambda about: about | change)
    with pytest.raises(ValueError, match=r"model\.zip: ") as raised:
        read_actor(tmp_path / "model.zip")
    assert said in str(raised.value)


def test_files_and_scenarios_that_do_not_fit(tmp_path, capsys):
    (tmp_path / "none.zip").write_bytes(b"nothing")
    assert "not a zip that Stable-Baselines3 wrote" in stopped(
        capsys, "export-sb3", str(tmp_path / "none.zip"), "--scenario", SCENARIO
    )
    assert "there is no such file; give the zip" in stopped(capsys, "export-sb3", "no.zip", "--scenario", SCENARIO)
    guarded = f"guarded:{tmp_path / 'none.zip'}"
    assert "not a zip that Stable" in stopped(capsys, "evaluate", guarded, "--scenario", SCENARIO, "--trust")
    made(PPO).save(tmp_path / "model")
    said = stopped(capsys, "export-sb3", str(tmp_path / "model.zip"))
    assert "names no scenario of dcgrid list; add --scenario" in said
    said = stopped(capsys, "export-sb3", str(tmp_path / "model.zip"), "--scenario", "ieee33-weak")
    assert "observation and action have 23 and 4 figures; on ieee33-weak they have 55 and 10 (joint), 10 and 2" in said
    said = stopped(capsys, "export-sb3", str(tmp_path / "model.zip"), "--scenario", SCENARIO, "--out", "policy.pt")
    assert "out: must end in .safetensors, got 'policy.pt'" in said


def test_what_acts_otherwise_than_it_says_is_refused(tmp_path, capsys):
    model = made(PPO, policy_kwargs=SMALL | {"features_extractor_class": Doubled})
    model.save(tmp_path / "plain")
    hidden = {"features_extractor_class": "<class 'stable_baselines3.common.torch_layers.FlattenExtractor'>"}
    rewritten(
        tmp_path / "plain.zip", tmp_path / "model.zip",
        lambda about: about | {"policy_kwargs": about["policy_kwargs"] | hidden},
    )  # fmt: skip
    file = str(tmp_path / "model.zip")
    said = stopped(capsys, "export-sb3", file, "--scenario", SCENARIO, "--out", str(tmp_path / "policy"), "--trust")
    assert "act otherwise than Stable-Baselines3 does" in said
    assert not list(tmp_path.glob("policy*"))


@pytest.mark.slow
def test_a_zip_of_gymnasium_is_evaluated(tmp_path, capsys):
    """A model without a form fits the scenario by its widths; a zip of SAC does not show whether it was normalised."""
    made(SAC).save(tmp_path / "model")
    options = ("--scenario", SCENARIO, "--episodes", "2", "--out", str(tmp_path))
    main(["evaluate", str(tmp_path / "model.zip"), *options, "--trust"])
    trusted_table = capsys.readouterr().out
    with pytest.warns(UnknownNormalisationWarning, match="a zip of sac does not show whether the model was trained"):
        main(["evaluate", str(tmp_path / "model.zip"), *options])
    assert capsys.readouterr().out == trusted_table
    assert "scenario: must be given for policy" in stopped(capsys, "evaluate", str(tmp_path / "model.zip"))

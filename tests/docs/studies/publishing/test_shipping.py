"""From training runs to a policy that ships."""

import json

import numpy as np
import pytest

from dcgrid_env import make_scenario, scenario_hash
from dcgrid_env.agents import Card, Network, Policy, PolicyError, evaluate
from dcgrid_env.baselines import make_controller
from docs.studies.commands import main as studies
from docs.studies.publishing.rescore import rescored
from docs.studies.publishing.shipping import ship


def trained(folder, seed, q_share, validation_j, scenario="toy6", **more):
    """A run's folder; the policy gives the same share everywhere."""
    networks = {"datacenter": Network([(np.zeros((9, 2)), [1.0, q_share])])}
    networks["inverter"] = Network([(np.zeros((7, 1)), [q_share])])
    policy = Policy(networks, scenario=scenario, made_with=f"dcgrid train ppo --seed {seed}")
    made = {"algorithm": "ppo", "seed": seed, "training_s": 2.0, "validation_J": validation_j, **more}
    policy.save(folder / f"run{seed}" / "policy", made)
    return folder / f"run{seed}"


@pytest.mark.slow
def test_the_best_on_validation_ships_with_the_scores_of_all(tmp_path):
    shares = (0.1, 0.2, 0.3)
    runs = [
        trained(tmp_path, seed, share, j) for seed, share, j in zip((5, 6, 7), shares, (0.4, 0.3, 0.5), strict=True)
    ]
    card = ship(runs, "toy6-ppo", episodes=4, out=tmp_path / "out")
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == ["toy6-ppo.json", "toy6-ppo.safetensors"]
    assert Card.load(tmp_path / "out" / "toy6-ppo.json") == card
    policy = Policy.load(tmp_path / "out" / "toy6-ppo.safetensors")
    assert policy.sha256 == card.sha256 == Policy.load(runs[1] / "policy.safetensors").sha256
    assert (card.seed, card.command, card.validation_J) == (6, "dcgrid train ppo --seed 6", 0.3)
    test, scored = make_scenario("toy6", split="test"), card.scored
    assert scored is not None
    assert (scored.scenario, scored.split, scored.episodes) == ("toy6", "test", 4)
    assert scored.scenario_hash == scenario_hash(test)
    droop = evaluate(make_controller("droop-tuned", test), test, range(4))
    own = evaluate(policy, test, range(4))
    assert own.means["J"] == scored.J
    assert tuple(own.score(droop).score) == scored.score
    assert scored.seeds == (5, 6, 7)
    assert scored.seed_scores[1] == pytest.approx(scored.score[0])
    assert len(set(scored.seed_scores)) == 3
    assert scored.over_seeds is not None
    mean, low, high = scored.over_seeds
    assert low < mean < high
    assert mean == pytest.approx(np.mean(scored.seed_scores))
    assert scored.seed_validation_J == (0.4, 0.3, 0.5)  # by which anyone can check the selection
    assert scored.seed_J is not None
    assert (scored.droop_J, scored.seed_J[1]) == (droop.means["J"], scored.J)
    assert rescored(card, policy) == card
    halved = rescored(card, policy, episodes=2).scored
    assert halved is not None
    assert (halved.episodes, halved.seeds, halved.seed_validation_J, halved.over_seeds) == (2, (6,), None, None)
    assert card.inputs is not None
    assert set(card.inputs) == {"datacenter", "inverter"}


@pytest.mark.slow
def test_a_policy_can_be_scored_on_another_scenario_than_its_own(tmp_path):
    card = ship([trained(tmp_path, 0, 0.2, 0.4)], "any-feeder", "ieee33", episodes=2, out=tmp_path / "out")
    assert card.scenario == "toy6"
    assert card.scored is not None
    assert card.scored.scenario == "ieee33"
    mixed = trained(tmp_path, 1, 0.2, 0.4, "toy6,ieee33")
    with pytest.raises(PolicyError, match="trained on toy6,ieee33; say on which preset it is scored"):
        ship([mixed], "any-feeder", episodes=2, out=tmp_path / "out")
    assert ship([mixed], "any-feeder", "toy6", episodes=2, out=tmp_path / "out").scenario == "toy6,ieee33"


def test_what_cannot_ship_is_named_and_writes_nothing(tmp_path):
    good = trained(tmp_path, 0, 0.2, 0.4)
    cases = [
        ([], "toy6-ppo", "folders: must name at least one folder"),
        ([good, good], "toy6-ppo", "seed 0 is there twice"),
        (
            [good, trained(tmp_path, 1, 0.2, 0.4, algorithm="sac")],
            "toy6-ppo",
            "algorithm is 'sac', that of .* is 'ppo'; give runs",
        ),
        ([trained(tmp_path, 2, 0.2, None)], "toy6-ppo", r"run2.policy\.json: validation_J is missing; train again"),
        ([good], "ieee33-ppo", "name is 'ieee33-ppo', the policy was trained on toy6"),
        ([good], "a/b", "name is 'a/b'; give a plain name"),
        ([good], "", "name is ''; give a plain name"),
    ]
    for folders, name, message in cases:
        with pytest.raises(PolicyError, match=message):
            ship(folders, name, episodes=2, out=tmp_path / "out")
    with pytest.raises(OSError, match="nowhere"):
        ship([tmp_path / "nowhere"], "toy6-ppo", episodes=2, out=tmp_path / "out")
    path = good / "policy.json"
    path.write_text(json.dumps(json.loads(path.read_text()) | {"sha256": "0" * 64}))
    with pytest.raises(PolicyError, match=r"policy\.json: sha256 is '0+', that of policy\.safetensors is"):
        ship([good], "toy6-ppo", episodes=2, out=tmp_path / "out")
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("nowhere", "--name", "toy6-ppo", "--out", "new"), "nowhere"),
        (("x", "--name", "y", "--episodes", "1"), "episodes: must be at least 2 for a score's interval, got 1"),
    ],
)
def test_a_command_that_cannot_ship_is_one_line(tmp_path, monkeypatch, capsys, words, message):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(SystemExit) as stopped:
        studies(["ship", *words])
    said = capsys.readouterr().err
    assert (stopped.value.code, len(said.splitlines())) == (2, 1)
    assert message in said
    assert not list(tmp_path.iterdir())

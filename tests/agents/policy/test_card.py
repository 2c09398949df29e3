"""Cards: their contents, the refused ones, and those of the bundled policies."""

import dataclasses
import json
from importlib.metadata import version

import numpy as np
import pytest

from dcgrid_env import PRESETS, make_scenario, scenario_hash
from dcgrid_env.agents import Card, Network, Policy, PolicyError, evaluate
from dcgrid_env.agents.controllers import preset_of, without_horizon
from dcgrid_env.agents.policy.card import Scored
from dcgrid_env.agents.policy.input_range import InputRange
from dcgrid_env.agents.policy.policy import FOLDER, SHIPPED
from dcgrid_env.baselines import NeedsPlacement

SCORED = Scored("toy6", "test", 100, "7b9bd19834108981", 0.27, 0.0, 0.0, (0.5, 0.4, 0.6), (0, 1), (0.5, 0.3))
CARD = Card("0.1.0", 12, "0" * 64, "ppo", "toy6", "dcgrid train ppo", 0, 1.5, 0.3, SCORED)


def belongs(folder, name):
    """Check that a policy and the card next to it belong together."""
    policy, card = Policy.load(folder / f"{name}.safetensors"), Card.load(folder / f"{name}.json")
    assert card.sha256 == policy.sha256
    assert card.n_parameters == policy.n_parameters
    assert card.scenario == policy.trained_on
    return policy, card


def test_a_card_comes_back_as_it_was_saved(tmp_path):
    for card in (CARD, dataclasses.replace(CARD, seed=None, training_s=None, validation_J=2, scored=None)):
        card.save(tmp_path / "new" / "card.json")
        assert Card.load(tmp_path / "new" / "card.json") == card
    assert [file.name for file in (tmp_path / "new").iterdir()] == ["card.json"]


def test_the_card_of_what_was_just_made():
    card = Card.of("a" * 64, 7, {"algorithm": "sac", "seed": 1})
    assert (card.version, card.n_parameters, card.algorithm, card.seed) == (version("dcgrid-env"), 7, "sac", 1)
    with pytest.raises(PolicyError, match="card: score is no field of it; give some of algorithm, scenario, seed"):
        Card.of("a" * 64, 7, {"score": 1.0})


@pytest.mark.parametrize(("field", "value"), [("seed", 1.5), ("seed", True), ("training_s", "2"), ("algorithm", None)])
def test_a_field_of_another_type_is_refused(field, value):
    with pytest.raises(ValueError, match=field):
        dataclasses.replace(CARD, **{field: value})


def test_a_card_of_the_first_format_loads(tmp_path):
    path = tmp_path / "card.json"
    CARD.save(path)
    old = json.loads(path.read_text())
    del old["inputs"], old["format"], old["scored"]["over_seeds"]
    path.write_text(json.dumps(old))
    assert Card.load(path) == dataclasses.replace(CARD, format=1)
    path.write_text(json.dumps(old | {"format": 4}))
    with pytest.raises(PolicyError, match="format is 4; this dcgrid reads 1 to 3; update it"):
        Card.load(path)


def test_the_range_of_inputs_comes_back_and_is_checked(tmp_path):
    own = InputRange(("v_deviation", "r"), (-1.0, 0.2), (1.0, 0.2))
    card = dataclasses.replace(CARD, inputs={"inverter": own})
    card.save(tmp_path / "card.json")
    assert Card.load(tmp_path / "card.json") == card
    for broken in (own._replace(low=(1.5, 0.2)), own._replace(high=(np.inf, 0.2)), own._replace(low=(0.2,))):
        with pytest.raises(ValueError, match=r"inputs\.inverter"):
            dataclasses.replace(CARD, inputs={"inverter": broken})


def test_what_is_no_card_is_refused_by_name(tmp_path):
    path = tmp_path / "card.json"
    CARD.save(path)
    whole = json.loads(path.read_text())
    for content in ("", "[]", "{}", path.read_text()[:-20], json.dumps(whole | {"colour": 1})):
        path.write_text(content)
        with pytest.raises(
            PolicyError, match=r"card\.json: (not a policy's card|is not JSON) \(.*\); give .*Policy\.save"
        ):
            Card.load(path)
    with pytest.raises(OSError, match=r"nowhere\.json"):
        Card.load(tmp_path / "nowhere.json")


def test_a_card_belongs_to_its_weights(tmp_path):
    Policy({"inverter": Network([(np.zeros((7, 1)), [0.5])])}, scenario="toy6").save(tmp_path / "one")
    belongs(tmp_path, "one")
    Policy({"inverter": Network([(np.zeros((7, 1)), [0.25])])}, scenario="toy6").save(tmp_path / "two")
    (tmp_path / "two.json").replace(tmp_path / "one.json")
    with pytest.raises(PolicyError, match=r"one\.json: sha256 is '.*', that of one\.safetensors is"):
        Policy.load(tmp_path / "one.safetensors")


def test_what_ships_is_small_and_whole():
    files = [path for path in FOLDER.iterdir() if path.suffix in (".safetensors", ".json")]
    assert {path.stem for path in files} == set(SHIPPED)
    assert len(files) == 2 * len(SHIPPED)
    assert sum(path.stat().st_size for path in files) < 5e6


@pytest.mark.parametrize("name", SHIPPED)
def test_what_ships_has_a_card_of_this_package_and_its_presets(name):
    policy, card = belongs(FOLDER, name)
    assert preset_of(name) in (without_horizon(card.scenario), None)
    made, now = ([int(part) for part in text.split(".")] for text in (card.version, version("dcgrid-env")))
    assert made <= now
    assert card.seed is not None
    assert card.training_s is not None
    assert card.scored is not None
    assert card.scored.scenario in PRESETS
    assert card.scored.split == "test"
    assert card.seed in card.scored.seeds
    assert card.inputs is not None or isinstance(policy, NeedsPlacement)  # what a guard falls back by
    own = card.scored.seeds.index(card.seed)
    assert card.scored.seed_scores[own] == pytest.approx(card.scored.score[0])
    assert card.scored.seed_J is not None
    assert card.scored.seed_J[own] == pytest.approx(card.scored.J)
    assert card.scored.droop_J is not None
    assert card.scored.seed_validation_J is not None
    assert card.scored.seed_validation_J[own] == card.validation_J == min(card.scored.seed_validation_J)
    assert card.scored.scenario_hash == scenario_hash(make_scenario(card.scored.scenario, split="test"))


@pytest.mark.slow
@pytest.mark.parametrize("name", [name for name in SHIPPED if name.startswith("ieee33-weak")])  # one preset: 4 s each
def test_what_a_card_claims_comes_out_again(name):
    scored = Card.load(FOLDER / f"{name}.json").scored
    assert scored is not None
    test = make_scenario(scored.scenario, split="test")
    found = evaluate(Policy.load(name), test, range(scored.episodes))
    # float32 networks: the last bits are the machine's.
    assert found.means["J"] == pytest.approx(scored.J, rel=1e-4)
    assert found.means["delay_mean_s"] == pytest.approx(scored.delay_mean_s, abs=0.01)

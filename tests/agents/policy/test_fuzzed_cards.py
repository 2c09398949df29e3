"""Cards with something changed next to their weights: each is refused with one line, or reads as a valid card."""

import json
import random
import re

import pytest

from dcgrid_env.agents import Policy, PolicyError
from dcgrid_env.agents.policy.policy import FOLDER
from helpers.fuzzing import ODD_JSON, mutated_bytes

NAME = "toy6-ppo"
CARD = (FOLDER / f"{NAME}.json").read_bytes()
ODD = [*ODD_JSON, "0" * 64]
FREE = {"version", "algorithm", "command", "training_s", "seed", "validation_J", "format", "scored", "inputs"}
"""Fields of a card that other values can have too: nothing in the weights contradicts them."""


@pytest.fixture
def load(tmp_path):
    """Read a copy of a bundled policy with another text for its card; return a PolicyError, do not raise it."""
    weights = tmp_path / f"{NAME}.safetensors"
    weights.write_bytes((FOLDER / weights.name).read_bytes())
    original = Policy.load(NAME)

    def read(card: bytes):
        weights.with_suffix(".json").write_bytes(card)
        policy, refused = None, None
        try:
            policy = Policy.load(weights)
        except PolicyError as error:
            refused = error
        if policy is None:
            assert len(str(refused).splitlines()) == 1
            assert str(refused).startswith(str(weights.with_suffix(".json")))
            return refused
        assert policy.sha256 == original.sha256
        assert policy.card is not None
        assert original.card is not None
        return {name for name, value in vars(policy.card).items() if value != getattr(original.card, name)}

    return read


@pytest.mark.slow
def test_damaged_cards_are_refused_or_valid(load):
    rng, refused = random.Random(1), 0
    for _ in range(1000):
        found = load(mutated_bytes({"card": CARD}, rng)["card"])
        refused += isinstance(found, PolicyError)
        assert isinstance(found, PolicyError) or found <= FREE
    assert refused > 500


def leaves(value, path=()):
    """Paths to all values of a mapping or list, the containers too."""
    for key, inner in value.items() if isinstance(value, dict) else enumerate(value):
        yield (*path, key)
        if isinstance(inner, dict | list):
            yield from leaves(inner, (*path, key))


def changed(path, value) -> bytes:
    card = json.loads(CARD)
    inner = card
    for key in path[:-1]:
        inner = inner[key]
    inner[path[-1]] = value
    return json.dumps(card).encode()


@pytest.mark.slow
def test_odd_values_are_refused_or_valid(load):
    rng = random.Random(2)
    for path in leaves(json.loads(CARD)):
        for value in rng.sample(ODD, 5):
            found = load(changed(path, value))
            assert isinstance(found, PolicyError) or found <= FREE, (path, value)


@pytest.mark.parametrize(("path", "value", "said"), [
    (("sha256",), "0" * 64, "sha256 is '0+', that of toy6-ppo.safetensors is"),
    (("n_parameters",), 12, "n_parameters is 12, that of"),
    (("scenario",), "ieee33", "scenario is 'ieee33', that of toy6-ppo.safetensors is 'toy6'"),
    (("colour",), 1, "colour"),
    (("scored", "colour"), 1, "colour"),
    (("seed",), 17, "seed is 17; give one of scored.seeds"),
    (("seed",), -1, "seed is -1"),
    (("training_s",), -2.0, "training_s is -2.0; input should be greater than or equal to 0"),
    (("training_s",), 10**400, "training_s is 10+; input should be a finite number"),
    (("command",), "a\nb", r"command is 'a\\nb'; give one line"),
    (("validation_J",), float("nan"), "validation_J is NaN|validation_J is nan"),
    (("scored", "score", 0), 0.999, "scored.score is 0.999, seed_scores has|scored.score is .0.999"),
    (("scored", "score", 2), -9.0, "score is .*-9.0.*; give an interval"),
    (("scored", "episodes"), 0, "episodes is 0; input should be greater than or equal to 1"),
    (("scored", "split"), "best", "split is 'best'; input should be 'train'"),
    (("scored", "scenario_hash"), "x", "scenario_hash is 'x'"),
    (("scored", "seeds", 1), 0, "seeds is .*each once"),
    (("scored", "over_seeds"), [0.1, 0.0, 0.2], "over_seeds is 0.1, the mean"),
    (("scored", "delay_mean_s"), -1.0, "delay_mean_s is -1.0"),
    (("inputs", "inverter"), {"fields": [], "low": [], "high": [], "mean": []}, "mean"),
    (("inputs", "battery"), {"fields": [], "low": [], "high": []}, "inputs are of"),
    (("inputs", "inverter", "low", 0), 10**400, "inputs.inverter.low.0 is 10+; input should be a finite number"),
])  # fmt: skip
def test_what_contradicts_is_named(load, path, value, said):
    found = load(changed(path, value))
    assert isinstance(found, PolicyError)
    assert re.search(said, str(found)), str(found)


def test_a_name_that_is_there_twice_is_refused(load):
    found = load(CARD.replace(b'"version"', b'"seed": 1, "version"', 1))
    assert "'seed' is there twice" in str(found)


def test_a_policy_without_a_card_is_read(tmp_path):
    path = tmp_path / "alone.safetensors"
    path.write_bytes((FOLDER / f"{NAME}.safetensors").read_bytes())
    assert Policy.load(path).card is None

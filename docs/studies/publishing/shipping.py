"""From the training runs of several seeds to a policy that ships: the best on validation, its card scored on test."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import tyro

from dcgrid_env import PRESETS, make_scenario, scenario_hash
from dcgrid_env.agents.controllers import preset_of, without_horizon
from dcgrid_env.agents.policy.card import FORMAT, Card, Scored
from dcgrid_env.agents.policy.input_range import recorded
from dcgrid_env.agents.policy.neural_network import PolicyError
from dcgrid_env.agents.policy.policy import FOLDER, Policy
from dcgrid_env.agents.policy.policy_file import SUFFIX
from dcgrid_env.agents.policy.unseen import on_purpose, trained_scenarios
from dcgrid_env.agents.training.config import FREE, stored_config
from dcgrid_env.baselines import NeedsPlacement, make_controller
from dcgrid_env.baselines.evaluation import Evaluation, evaluate, hindsight_costs
from dcgrid_env.baselines.score import REFERENCE, SPLIT, mean_over_seeds, score_error
from dcgrid_env.cli.listing import card_line
from dcgrid_env.core.commands.command import Command
from dcgrid_env.core.commands.terminal import plain_console, say, working
from dcgrid_env.core.files import write_bytes


def ship(
    folders: Sequence[Path], name: str, scenario: str | None = None, episodes: int = 100, out: Path = FOLDER
) -> Card:
    """Score the policies of training runs that differ in the seed alone, and write the best on validation.

    Parameters
    ----------
    folders
        Folders of the runs, each with policy.safetensors and policy.json.
    name
        Name of the policy; ``PRESET-NAME`` is found as NAME on that preset.
    scenario
        Preset on whose test split they are scored; that of the training unless given.
    episodes
        Seeds 0, 1, .. of the test split.
    out
        Folder for NAME.safetensors and NAME.json.

    Returns
    -------
    Card
        The card that was written.

    Raises
    ------
    PolicyError
        For runs of different scenarios or algorithms, or twice of the same seed, a card of other weights, or one
        without a seed, training time or validation cost.
    ValueError
        If a score is missing, see :meth:`Evaluation.score`.
    """
    runs = [_read(folder) for folder in folders]
    cards = [card for _, card in runs]
    _check(cards, folders, name)
    trained_on = cards[0].scenario
    if scenario is None and trained_on not in PRESETS:
        raise PolicyError(f"scenario: the policy was trained on {trained_on}; say on which preset it is scored")
    test = make_scenario(scenario or trained_on, split=SPLIT)
    with on_purpose():  # the scenario was asked for
        evaluations = [evaluate(policy, test, range(episodes)) for policy, _ in runs]
    validation_j = [card.validation_J or 0.0 for card in cards]
    best = validation_j.index(min(validation_j))
    scored = scored_as(
        evaluations[best],
        tuple(card.seed or 0 for card in cards),
        tuple(one.means["J"] for one in evaluations),
        tuple(validation_j),
    )
    card = dataclasses.replace(cards[best], scored=scored)
    if card.inputs is None:
        card = with_inputs(card, runs[best][0])
    write_bytes(out / f"{name}{SUFFIX}", _weights(folders[best]).read_bytes())
    card.save(out / f"{name}.json")
    return card


def scored_as(
    evaluation: Evaluation, seeds: tuple[int, ...], seed_j: tuple[float, ...], validation_j: tuple[float, ...] | None
) -> Scored:
    """Scores of a policy and of all seeds from its evaluation and their mean costs."""
    test, n = evaluation.scenario, len(evaluation.seeds)
    droop = evaluate(make_controller(REFERENCE, test), test, evaluation.seeds)
    found, best = evaluation.score(droop).score, hindsight_costs(test, evaluation.seeds)
    possible = float(np.mean(droop.J - best))
    scores = tuple((droop.means["J"] - j) / possible for j in seed_j)
    over_seeds = mean_over_seeds(scores, score_error(evaluation.J, droop.J, best), n) if len(seeds) > 1 else None
    return Scored(
        scenario=test.name,
        split=SPLIT,
        episodes=n,
        scenario_hash=scenario_hash(test),
        J=evaluation.means["J"],
        delay_mean_s=evaluation.means["delay_mean_s"],
        droop_delay_mean_s=droop.means["delay_mean_s"],
        score=(found.value, found.low, found.high),
        seeds=seeds,
        seed_scores=scores,
        over_seeds=None if over_seeds is None else (over_seeds.value, over_seeds.low, over_seeds.high),
        droop_J=droop.means["J"],
        seed_J=seed_j,
        seed_validation_J=validation_j,
    )


def with_inputs(card: Card, policy: Policy) -> Card:
    """A card with the range of the policy's inputs, as it drives what the card says that it was trained on.

    The card as it is for a policy that is given a model of the feeder: its inputs are figures of a law.
    """
    if isinstance(policy, NeedsPlacement):
        return card
    scenarios = trained_scenarios(card.scenario)
    return dataclasses.replace(card, inputs=recorded(policy, scenarios), format=FORMAT)


def _weights(folder: Path) -> Path:
    return folder / f"policy{SUFFIX}"


def _read(folder: Path) -> tuple[Policy, Card]:
    """Read a run's policy and card; PolicyError unless they match and the card describes the training."""
    policy, path = Policy.load(_weights(folder)), folder / "policy.json"
    card = policy.card
    if card is None:
        raise PolicyError(f"{path}: there is no such card; train again")
    for field in ("algorithm", "scenario", "command", "seed", "training_s", "validation_J"):
        if getattr(card, field) in ("", None):
            raise PolicyError(f"{path}: {field} is missing; train again")
    return policy, card


def _check(cards: Sequence[Card], folders: Sequence[Path], name: str) -> None:
    if not cards:
        raise PolicyError("folders: must name at least one folder of a training run, got none")
    if not name or Path(name).name != name or Path(name).suffix:
        raise PolicyError(f"name is {name!r}; give a plain name without folder or suffix")
    preset = preset_of(name)
    if preset and preset != without_horizon(cards[0].scenario):
        raise PolicyError(f"name is {name!r}, the policy was trained on {cards[0].scenario}; name it after that")
    for card, folder in zip(cards, folders, strict=True):
        for field in ("algorithm", "scenario", "version"):
            one, other = getattr(cards[0], field), getattr(card, field)
            if one != other:
                raise PolicyError(
                    f"{folder}: {field} is {other!r}, that of {folders[0]} is {one!r}; give runs of one kind"
                )
    _check_settings(folders)
    twice = [card.seed for card in cards if sum(other.seed == card.seed for other in cards) > 1]
    if twice:
        raise PolicyError(f"folders: seed {twice[0]} is there twice; give each run once")


def _check_settings(folders: Sequence[Path]) -> None:
    """PolicyError where configurations that the runs kept differ in more than seed and place."""
    configurations = {folder: settings for folder in folders if (settings := stored_config(folder)) is not None}
    for folder, settings in configurations.items():
        first, other = next(iter(configurations.items()))
        for field in sorted(set(settings) | set(other)):
            if field not in ("seed", *FREE) and settings.get(field) != other.get(field):
                raise PolicyError(
                    f"{folder}: {field} is {settings.get(field)!r}, that of {first} is {other.get(field)!r}; give runs "
                    "that differ in the seed alone"
                )


@dataclass(frozen=True)
class Ship(Command):
    """Score training runs with different seeds; save the best.

    All runs are scored on the test split. The run with the best validation cost is saved as a policy, with its card.
    """

    folders: tyro.conf.Positional[tuple[Path, ...]]
    """Folders of training runs (dcgrid train), one for each seed."""
    name: str
    """Name of the policy, usually SCENARIO-ALGORITHM."""
    scenario: str | None = None
    """Preset to score on. Default: the preset of the training."""
    episodes: int = 100
    """Number of test episodes, at least 2, with seeds 0, 1, ..."""
    out: Path = Path("results/policies")
    """Folder for NAME.safetensors and NAME.json."""

    def run(self) -> None:
        """Score, write and print; raise ValueError before writing if the runs do not belong together."""
        if self.episodes < 2:
            raise ValueError(f"episodes: must be at least 2 for a score's interval, got {self.episodes}")
        console = plain_console()
        with working(console, f"{len(self.folders)} policies, {self.episodes} episodes each"):
            card = ship(self.folders, self.name, self.scenario, self.episodes, self.out)
        say(console, f"{self.name}: {card_line(card)}")
        say(console, f"wrote {self.out / self.name}.safetensors and .json")

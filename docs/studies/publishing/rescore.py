"""Scores of bundled policies against the reference and hindsight as they are now."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import tyro

from dcgrid_env import make_scenario
from dcgrid_env.agents.policy.card import FORMAT, Card
from dcgrid_env.agents.policy.neural_network import PolicyError
from dcgrid_env.agents.policy.policy import FOLDER, SHIPPED, Policy
from dcgrid_env.agents.policy.unseen import on_purpose
from dcgrid_env.baselines.evaluation import evaluate
from dcgrid_env.cli.listing import card_line
from dcgrid_env.core.commands.command import Command
from dcgrid_env.core.commands.terminal import plain_console, say
from docs.studies.publishing.shipping import scored_as


def rescored(card: Card, policy: Policy, episodes: int | None = None) -> Card:
    """A bundled policy's card with scores against the reference and hindsight as they are now.

    The costs of the other seeds' policies stay; over another number of episodes they are not known and left out.
    """
    scored = card.scored
    if scored is None or card.seed is None or scored.seed_J is None:
        raise PolicyError("card: it has no costs of its seeds; ship the policy again")
    test = make_scenario(scored.scenario, split=scored.split)
    n = episodes or scored.episodes
    with on_purpose():
        own = evaluate(policy, test, range(n))
    if n == scored.episodes:
        seeds, j, validation_j = scored.seeds, scored.seed_J, scored.seed_validation_J
    else:
        seeds, j, validation_j = (card.seed,), (own.means["J"],), None
    return dataclasses.replace(card, scored=scored_as(own, seeds, j, validation_j), format=FORMAT)


@dataclass(frozen=True)
class Rescore(Command):
    """Score bundled policies again and write their cards.

    Scores them against the tuned droop and hindsight as they are now.

    The costs of the other training seeds on the test split are those of the card.
    """

    names: tyro.conf.Positional[tuple[str, ...]]
    """Names of policies (dcgrid list)."""
    episodes: int | None = None
    """Test episodes: seeds 0, 1, ... Over another number than the card's, the other seeds are left out."""

    def run(self) -> None:
        """Score, write, print. ValueError for a name that no bundled policy has, before anything is written."""
        if unknown := [name for name in self.names if name not in SHIPPED]:
            raise ValueError(f"no bundled policy is named {unknown[0]!r}; choose among those of dcgrid list")
        if self.episodes is not None and self.episodes < 2:
            raise ValueError(f"episodes is {self.episodes}; give at least 2, a score's interval takes them")
        for name in self.names:
            path = FOLDER / f"{name}.json"
            card = rescored(Card.load(path), Policy.load(name), self.episodes)
            card.save(path)
            say(plain_console(), f"{name}: {card_line(card)}")

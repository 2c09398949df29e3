"""Scopes: which parts of an episode are sent to the processes of an entry.

A scope is a text of words in the order of ``WORDS``, joined by " + ", such as "local + sensitivities". The first word
is ``local`` or ``joint``. The preset is public, so a scope does not restrict what an author builds into an entry.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from dcgrid_env import RegulatorState, Scenario, action_layout, field_names
from dcgrid_env.agents.leaderboard.entry_files import SubmissionError
from dcgrid_env.agents.policy.unseen import on_purpose
from dcgrid_env.baselines import Controller, NeedsPlacement, NeedsRegulators
from dcgrid_env.baselines.rollout import as_driven, transitions

LOCAL, JOINT, SENSITIVITIES, TOTALS, REGULATORS, MODEL = (
    "local", "joint", "sensitivities", "totals", "regulators", "model",
)  # fmt: skip
WIDER = {"neighbours": "neighbours", "feeder": "voltages"}
"""Word of a scope for each wider value of ``Scenario.observe``."""
WORDS = {
    LOCAL: "each agent's own measurements, to a process that drives this agent alone",
    JOINT: "the measurements of all agents, to one process that drives all of them",
    SENSITIVITIES: "R_ii and X_ii at the buses of these agents, from the feeder's model",
    TOTALS: "sums over all sites",
    "neighbours": "voltage and powers of the three electrically nearest agents",
    "voltages": "the voltage of every node",
    REGULATORS: "taps, relay volts and timers of all regulators of a three-phase feeder",
    MODEL: "the buses of all agents, which make the preset's feeder a model of the episode",
}
"""Words of scopes and what each of them sends."""
STEPS = 20
"""Steps over which the inputs of a controller of the package are measured."""
EQUAL = 1e-5
"""Largest difference of actions that rounding explains."""


@dataclass(frozen=True)
class Scope:
    """The parts of an episode that an entry is sent."""

    words: frozenset[str]

    @classmethod
    def of(cls, *words: str) -> Scope:
        """Make a scope; SubmissionError for an unknown word, or unless exactly one of local and joint is there."""
        wrong = [word for word in words if word not in WORDS]
        if wrong or len({LOCAL, JOINT} & set(words)) != 1 or len(set(WIDER.values()) & set(words)) > 1:
            raise SubmissionError(
                f"scope is {' + '.join(words)!r}; give local or joint, then any of {', '.join(list(WORDS)[2:])} "
                "(neighbours or voltages, not both), joined by +"
            )
        return cls(frozenset(words))

    @classmethod
    def parse(cls, text: str) -> Scope:
        """Read a scope such as "local + sensitivities"; SubmissionError as of ``of``."""
        return cls.of(*(word.strip() for word in text.split("+")))

    def __str__(self) -> str:
        return " + ".join(word for word in WORDS if word in self.words)

    @property
    def observe(self) -> str:
        """Scope of observation of the scenario that has all the fields."""
        return next((observe for observe, word in WIDER.items() if word in self.words), "local")

    @property
    def sends_model(self) -> bool:
        """Whether the buses of the agents are sent."""
        return MODEL in self.words

    @property
    def sends_regulators(self) -> bool:
        """Whether measurements of the regulators are sent."""
        return REGULATORS in self.words

    def groups(self, scenario: Scenario) -> list[tuple[str, ...]]:
        """Agents that one process drives, for each process."""
        return [scenario.agents] if JOINT in self.words else [(agent,) for agent in scenario.agents]

    def columns(self, scenario: Scenario, agents: Sequence[str]) -> np.ndarray:
        """Positions in the joint observation that the process of these agents is sent."""
        withheld = {SENSITIVITIES: {"r", "x"}, TOTALS: totals(scenario)}
        hidden = {name for word, names in withheld.items() if word not in self.words for name in names}
        names = [(agent, name) for agent, fields in field_names(scenario).items() for name in fields]
        return np.array([i for i, (agent, name) in enumerate(names) if agent in agents and name not in hidden])


def totals(scenario: Scenario) -> set[str]:
    """Names of the fields that take a sum over all sites."""
    return {
        field.name
        for device in scenario.devices
        for field in device.fields(scenario.horizon, scenario.dt_s)
        if field.of_all_sites
    }


def measured_scope(make: Callable[[], Controller], scenario: Scenario, name: str) -> Scope:
    """Find the narrowest scope under which a controller of the package acts as it does on everything.

    An episode of the validation split is driven. Of its observations fresh controllers see a part each, with NaN in
    place of the rest. A part whose absence changes no action does not belong to the scope.

    Parameters
    ----------
    make
        Makes a fresh controller.
    scenario
        The preset.
    name
        What errors call the controller.

    Raises
    ------
    ControllerError
        A ValueError, where the controller cannot drive the preset.
    """
    whole = make()
    on = as_driven(scenario.replace(split="validation").member([0]), whole)
    trial = (_PlacedTrial if isinstance(whole, NeedsPlacement) else _Trial)(whole, make)
    with on_purpose():
        steps = transitions(on, trial, [0], name)
        for _ in range(min(STEPS, on.horizon)):
            next(steps)
        steps.close()
    wider = [WIDER[on.sensing.observe]] if on.sensing.observe in WIDER else []
    return Scope.of(*trial.needed, *wider, *([MODEL] if isinstance(whole, NeedsPlacement) else []))


class _Trial:
    """A controller that acts on everything, and copies of it that see less; it notes whose actions differ."""

    def __init__(self, whole: Controller, make: Callable[[], Controller]):
        self.whole, self._make = whole, make
        self.needed = [LOCAL]

    def reset(self, env_info: Scenario) -> None:
        """Begin the episode."""
        agents, everything = env_info.agents, Scope.of(JOINT, SENSITIVITIES, TOTALS, REGULATORS)
        n_seen = len(everything.columns(env_info, agents))
        layout = action_layout(env_info)
        self._copies: dict[str, tuple[Controller, np.ndarray, np.ndarray]] = {}
        for word in (JOINT, SENSITIVITIES, TOTALS, REGULATORS):
            scope = Scope(everything.words - {word} | ({LOCAL} if word == JOINT else set()))
            seen, driven = [], []
            for group in scope.groups(env_info):
                seen.append(np.isin(np.arange(n_seen), scope.columns(env_info, group)))
                driven.append([agent in group for agent, _ in layout.names])
            if not np.all(seen) or len(seen) > 1 or (word == REGULATORS and isinstance(self.whole, NeedsRegulators)):
                self._copies[word] = self._make(), np.array(seen), np.array(driven)
        for controller in (self.whole, *(copy for copy, *_ in self._copies.values())):
            controller.reset(env_info)

    def measure(self, regulators: RegulatorState) -> None:
        """Give the measurements to all but the copy without them."""
        given = [
            (self.whole, 1),
            *((copy, len(seen)) for word, (copy, seen, _) in self._copies.items() if word != REGULATORS),
        ]
        for controller, n in given:
            if isinstance(controller, NeedsRegulators):
                controller.measure(RegulatorState(*(np.repeat(values, n, axis=0) for values in regulators)))

    def act(self, observations: np.ndarray) -> Any:
        """Actions on everything."""
        action = np.asarray(self.whole.act(observations))
        for word, (copy, seen, driven) in list(self._copies.items()):
            try:
                with np.errstate(all="ignore"):
                    other = np.asarray(copy.act(np.where(seen, observations, np.float32(np.nan))))
                equal = np.allclose(other[driven], np.broadcast_to(action, other.shape)[driven], rtol=0.0, atol=EQUAL)
            except Exception:  # it cannot act on NaN
                equal = False
            if not equal:
                del self._copies[word]
                self.needed = [JOINT if word == JOINT else one for one in self.needed] + [word] * (word != JOINT)
        return action


class _PlacedTrial(_Trial):
    """A trial of a controller that is given the buses."""

    def place(self, buses: np.ndarray) -> None:
        """Give all the same buses."""
        for controller, n in [(self.whole, 1), *((copy, len(seen)) for copy, seen, _ in self._copies.values())]:
            if isinstance(controller, NeedsPlacement):
                controller.place(np.repeat(buses, n, axis=0))

"""Search the best known cost of episodes that no linear program describes.

A linear program describes neither trips nor smoothing by settings that stay constant for seconds. Hence an optimum to
compare with is missing, and the best known cost of the same episode replaces it. The search begins with the best
trajectory of some controllers, or with a recorded one, and changes single actions. The result is not a bound.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from dcgrid_env import Scenario
from dcgrid_env.baselines import Controller
from dcgrid_env.baselines.laws.fixed_smoothing import has_smoothing_channels
from dcgrid_env.baselines.laws.site_return import return_rule
from dcgrid_env.baselines.recorded_actions import rounded
from dcgrid_env.baselines.rollout import as_driven, transitions
from docs.studies.best_known.blocks import BlockSearch
from docs.studies.best_known.descent import Descent
from docs.studies.best_known.driving import driven


class Known(NamedTuple):
    """The best known trajectory of an episode."""

    J: float
    start: str
    """Whose trajectory the search began with, usually the name of a controller."""
    rounds: int
    """Rounds of the search since."""
    actions: np.ndarray
    """(step, n_action)."""


def best_known(
    scenario: Scenario,
    seeds: Sequence[int],
    controllers: Mapping[str, Controller],
    known: Mapping[int, Known],
    rounds: int,
    on_round: Callable[[], None] = lambda: None,
) -> list[Known]:
    """Search the least cost of each episode.

    Parameters
    ----------
    scenario
        A scenario whose agents decide over the return of sites, or over smoothing.
    seeds
        One episode each.
    controllers
        Controllers to begin with, by name.
    known
        What is known of some of the episodes, to begin with as well.
    rounds
        Rounds of the search.
    on_round
        Called after each (for progress).

    Raises
    ------
    ValueError
        For a scenario without these channels, or an episode that nothing is given to begin with.
    """
    smooths = has_smoothing_channels(scenario)
    if not smooths:
        return_rule(scenario)
    starts = begin_with(scenario, seeds, controllers, known)
    if not rounds:
        return starts
    actions = np.stack([start.actions for start in starts], axis=1)
    search = Descent(scenario, seeds, actions, rounds) if smooths else BlockSearch(scenario, seeds, actions)
    for _ in range(rounds):
        search.advance()
        on_round()
    trajectories = search.actions.swapaxes(0, 1)
    return [
        Known(float(j), start.start, start.rounds + rounds, own)
        for j, start, own in zip(search.J, starts, trajectories, strict=True)
    ]


def begin_with(
    scenario: Scenario, seeds: Sequence[int], controllers: Mapping[str, Controller], known: Mapping[int, Known]
) -> list[Known]:
    """Return the trajectory of each episode that costs least, among those of the controllers and the known ones."""
    found = {seed: known[seed] for seed in seeds if seed in known}
    for name, controller in controllers.items():
        recorder = _Recorder(controller)
        on = as_driven(scenario, controller)
        steps = transitions(on, recorder, seeds, name)
        next(steps)
        for _ in range(scenario.horizon):
            next(steps)
        steps.close()
        actions = rounded(np.stack(recorder.actions))
        j, _ = driven(scenario, seeds, actions)
        for i, seed in enumerate(seeds):
            if seed not in found or j[i] < found[seed].J:
                found[seed] = Known(float(j[i]), name, 0, actions[:, i])
    if missing := [seed for seed in seeds if seed not in found]:
        raise ValueError(f"controllers: give at least one, nothing is known of episode {missing[0]} to begin with")
    return [found[seed] for seed in seeds]


class _Recorder:
    """A controller whose actions are recorded."""

    def __init__(self, controller: Controller):
        self._controller = controller
        self.actions: list[np.ndarray] = []

    def reset(self, env_info: Scenario) -> None:
        self._controller.reset(env_info)

    def act(self, observations: np.ndarray) -> np.ndarray:
        action = np.array(self._controller.act(observations))
        self.actions.append(action)
        return action

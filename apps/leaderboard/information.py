"""Measure the information that a controller uses: its own agents' measurements, those of others, the feeder's model."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from dcgrid_env import RegulatorState, Scenario, action_layout, field_names
from dcgrid_env.baselines import Controller, NeedsPlacement, NeedsRegulators
from dcgrid_env.baselines.rollout import as_driven, transitions

WORDS = ("local", "joint", "sensitivities", "totals", "neighbours", "voltages", "regulators", "model")
"""Words of the result, in their order."""
LOCAL, JOINT, SENSITIVITIES, TOTALS, NEIGHBOURS, VOLTAGES, REGULATORS, MODEL = WORDS
WIDER = {"local": (), "neighbours": (NEIGHBOURS,), "feeder": (VOLTAGES,)}
"""Words for each value of ``Scenario.observe``."""
STEPS = 20
"""Steps over which the information is measured."""
EQUAL = 1e-5
"""Largest difference of actions that rounding explains."""


def measured_information(make: Callable[[], Controller], scenario: Scenario, name: str) -> str:
    """Find the information without which a controller acts differently.

    The controller drives an episode of the validation split. New copies of it act on the same observations, each with
    NaN in place of one kind of information. If an action of a copy differs, the controller uses that information.

    Parameters
    ----------
    make
        Function that makes a new controller.
    scenario
        Preset.
    name
        Name of the controller in errors.

    Returns
    -------
    str
        Words joined by " + ". The first is "local" if the channels of an agent depend only on that agent's
        measurements, otherwise "joint". Then "sensitivities" (R_ii and X_ii at the agents' buses), "totals" (sums over
        all sites), "neighbours" (the three nearest agents) or "voltages" (of all nodes), "regulators" (taps, relay
        volts and timers), and "model" (the buses of all agents, with which the feeder is a model of the episode).

    Raises
    ------
    ControllerError
        A ValueError, if the controller fails or cannot drive the preset.
    """
    controller = make()
    on = as_driven(scenario.replace(split="validation").member([0]), controller)
    trial = (_PlacedTrial if isinstance(controller, NeedsPlacement) else _Trial)(controller, make)
    steps = transitions(on, trial, [0], name)
    for _ in range(min(STEPS, on.horizon)):
        next(steps)
    steps.close()
    used = trial.used | set(WIDER[on.sensing.observe])
    used |= {JOINT if JOINT in used else LOCAL}
    used |= {MODEL} if isinstance(controller, NeedsPlacement) else set()
    return " + ".join(word for word in WORDS if word in used)


class _Trial:
    """A controller that acts on everything, and copies of it that observe less; ``used`` has what made a difference."""

    def __init__(self, controller: Controller, make: Callable[[], Controller]):
        self.controller, self._make = controller, make
        self.used: set[str] = set()

    def reset(self, env_info: Scenario) -> None:
        """Begin the episode."""
        self._copies = {
            word: (self._make(), observed, driven)
            for word, (observed, driven) in _masks(env_info).items()
            if not observed.all() or (word == REGULATORS and isinstance(self.controller, NeedsRegulators))
        }
        for controller in (self.controller, *(copy for copy, *_ in self._copies.values())):
            controller.reset(env_info)

    def measure(self, regulators: RegulatorState) -> None:
        """Pass the measurements of the regulators to all but the copy without them."""
        for controller, n in self._with_rows(without=REGULATORS):
            if isinstance(controller, NeedsRegulators):
                controller.measure(RegulatorState(*(np.repeat(values, n, axis=0) for values in regulators)))

    def act(self, observations: np.ndarray) -> Any:
        """Return the actions on everything, and compare those of the copies."""
        action = np.asarray(self.controller.act(observations))
        for word, (copy, observed, driven) in list(self._copies.items()):
            try:
                with np.errstate(all="ignore"):
                    other = np.asarray(copy.act(np.where(observed, observations, np.float32(np.nan))))
                equal = np.allclose(other[driven], np.broadcast_to(action, other.shape)[driven], rtol=0.0, atol=EQUAL)
            except Exception:  # it cannot act on NaN
                equal = False
            if not equal:
                del self._copies[word]
                self.used.add(word)
        return action

    def _with_rows(self, without: str = "") -> list[tuple[Controller, int]]:
        """The controller and its copies, and the number of rows that each acts on."""
        copies = [(copy, len(observed)) for word, (copy, observed, _) in self._copies.items() if word != without]
        return [(self.controller, 1), *copies]


class _PlacedTrial(_Trial):
    """A trial of a controller that receives the buses of the agents."""

    def place(self, buses: np.ndarray) -> None:
        """Pass the same buses to all."""
        for controller, n in self._with_rows():
            if isinstance(controller, NeedsPlacement):
                controller.place(np.repeat(buses, n, axis=0))


def _masks(scenario: Scenario) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Parts of observation and action without each kind of information: bool, (row, n_observation), (row, n_action).

    Without ``joint`` there is a row for each agent, with its own observation and its own channels.
    """
    names = [(agent, name) for agent, fields in field_names(scenario).items() for name in fields]
    channels = [agent for agent, _ in action_layout(scenario).names]
    hidden = {SENSITIVITIES: {"r", "x"}, TOTALS: total_fields(scenario), REGULATORS: set()}
    masks = {JOINT: ([[a == agent for a, _ in names] for agent in scenario.agents],
                     [[a == agent for a in channels] for agent in scenario.agents])}  # fmt: skip
    masks |= {
        word: ([[n not in fields for _, n in names]], [[True] * len(channels)]) for word, fields in hidden.items()
    }
    return {word: (np.array(observed), np.array(driven)) for word, (observed, driven) in masks.items()}


def total_fields(scenario: Scenario) -> set[str]:
    """Return the names of the observation fields that contain a sum over all sites."""
    return {
        field.name
        for device in scenario.devices
        for field in device.fields(scenario.horizon, scenario.dt_s)
        if field.of_all_sites
    }

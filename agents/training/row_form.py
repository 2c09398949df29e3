"""The form of a row: view and meaning of its actions, as a record that is stored with a model.

``RowActions`` is the action space of :func:`sb3_vec_env`. It is an ordinary Box with the record as ``form``.
Stable-Baselines3 writes the action space into the file of a model, as text that is read without unpickling. Scoring
and export therefore need no statement of how a model was trained.
"""

from __future__ import annotations

from reprlib import repr as shortened
from typing import Any, Literal, NamedTuple, Self, get_args

import numpy as np
from gymnasium import spaces

from dcgrid_env import Scenario, ScenarioError, under_own_control
from dcgrid_env.agents.policy.interface import Gains
from dcgrid_env.agents.policy.neural_network import PolicyError
from dcgrid_env.baselines import make_controller

View = Literal["joint", "shared", "channel"]
"""Whether a row is an environment, an agent of one, or a channel of an agent."""
Outputs = Literal["setpoint", "change", "droop"]
"""Meaning of an action: set points, changes from the action that keeps the state, or corrections of the tuned droop."""

CHOICES: dict[str, tuple[Any, ...]] = {
    "view": get_args(View),
    "outputs": get_args(Outputs),
    "nameplate": (True, False),
}
"""Values of the fields of a form."""

CORRECTS_DROOP = ("ieee13-3ph", "routing", "smoothing")
"""Presets on which actions correct the tuned droop by default (decision 51)."""
PAID_ALONE = ("ieee13-3ph",)
"""Presets on which policies trained by difference rewards cost more than the droop on validation."""


class RowForm(NamedTuple):
    """The view of a row and the meaning of its action, see :func:`sb3_vec_env`."""

    view: View = "joint"
    outputs: Outputs = "setpoint"
    nameplate: bool = False
    """Whether a row observes the effect of its ratings on its voltage."""
    gains: Gains | None = None
    """Gains of the droop that actions correct; None for other outputs."""
    scenario: str = ""
    """Name of the scenario of the training."""

    @classmethod
    def read(cls, stored: Any) -> Self:
        """Return the form from a mapping of its fields, as ``stored`` writes it.

        Raises PolicyError with the field's name if a field is missing or invalid.
        """
        if not isinstance(stored, dict) or set(stored) != set(cls._fields):
            raise PolicyError(f"action_space: form must have the fields {', '.join(cls._fields)}; save the model again")
        for name, choices in CHOICES.items():
            if not _is_one_of(stored[name], choices):
                choice = ", ".join(map(str, choices))
                raise PolicyError(
                    f"action_space: form has {name} {shortened(stored[name])}; it must be one of {choice}"
                )
        if not isinstance(stored["scenario"], str):
            raise PolicyError(f"action_space: form has scenario {shortened(stored['scenario'])}; it must be a name")
        try:
            gains = None if stored["gains"] is None else Gains.of(stored["gains"])
        except (TypeError, ValueError, OverflowError):
            raise PolicyError(
                f"action_space: form has gains {shortened(stored['gains'])}; it must be three numbers of at least 0"
            ) from None
        if (gains is None) == (stored["outputs"] == "droop"):
            raise PolicyError("action_space: form has gains exactly if its outputs are 'droop'; save the model again")
        fields: dict[str, Any] = stored | {"gains": gains}
        return cls(**fields)

    @property
    def stored(self) -> dict[str, Any]:
        """The fields as JSON takes them."""
        return self._asdict() | {"gains": None if self.gains is None else list(self.gains)}


class RowActions(spaces.Box):
    """Actions of a row, (n_action,) in [-1, 1]; ``form`` has the fields of its :class:`RowForm`.

    Parameters
    ----------
    form
        What the row is and what its action means.
    n_action
        Entries of an action.
    """

    def __init__(self, form: RowForm, n_action: int):
        super().__init__(-1.0, 1.0, (n_action,), np.float32)
        self.form = form.stored

    def __repr__(self) -> str:
        """The space with the view and the meaning of its actions."""
        return f"RowActions({self.shape}, view={self.form['view']!r}, outputs={self.form['outputs']!r})"

    def __eq__(self, other: object) -> bool:
        """Whether the spaces are equal and actions have the same meaning, so that a model can go on with the other."""
        meaning = [
            (space.form["view"], space.form["outputs"]) for space in (self, other) if isinstance(space, RowActions)
        ]
        return super().__eq__(other) and len(set(meaning)) == 1


def check_form(view: object, outputs: object, nameplate: object) -> None:
    """Raise ValueError unless each field that a user gives, not None, is valid and they go together."""
    for (name, choices), value in zip(CHOICES.items(), (view, outputs, nameplate), strict=True):
        if value is not None and not _is_one_of(value, choices):
            raise ValueError(f"{name} is {shortened(value)}; choose one of {', '.join(map(str, choices))}")
    if view == "joint" and nameplate:
        raise ValueError("nameplate is True with view 'joint'; choose view 'shared' or 'channel', or leave it out")


def _is_one_of(value: object, choices: tuple[Any, ...]) -> bool:
    """Return whether a value is one of these, of their type: 1 is not True."""
    return isinstance(value, type(choices[0])) and value in choices


def droop_gains(scenario: Scenario) -> Gains:
    """Return the gains of the tuned droop; raise ValueError if there are none for the scenario."""
    law: Any = make_controller("droop-tuned", scenario)
    return Gains(law.k_p_mw_per_pu, law.k_q_mvar_per_pu_s, law.alpha_per_s)


def learning_form(
    scenario: Scenario, view: View | None = None, outputs: Outputs | None = None, nameplate: bool | None = None
) -> RowForm:
    """Return the form with which training is fastest, with fields that are given unchanged.

    An action of 0 serves all work and does not change the reactive power. It is the tuned droop on the presets
    ``CORRECTS_DROOP``, and the middle of each range if regulators or capacitor banks are among the agents. Decision 51
    has the measurements.

    Parameters
    ----------
    scenario
        Scenario to train on.
    view, outputs, nameplate
        Fields that the user gives. By default a row is a channel of an agent. If regulators or capacitor banks are
        among the agents, it is an environment, and actions are set points.
    """
    has_equipment = under_own_control(scenario) is not scenario
    view = view or ("joint" if has_equipment else "channel")
    if outputs is None:
        outputs = "setpoint" if has_equipment else "droop" if _corrects_droop(scenario) else "change"
    gains = droop_gains(scenario) if outputs == "droop" else None
    return RowForm(view, outputs, view != "joint" if nameplate is None else nameplate, gains, scenario.name)


def _corrects_droop(scenario: Scenario) -> bool:
    """Return whether corrections of the droop are the default, which needs its gains for this scenario."""
    if scenario.name not in CORRECTS_DROOP:
        return False
    try:
        return droop_gains(scenario) is not None
    except ValueError:
        return False


def learning_reward(scenario: Scenario) -> Scenario:
    """Return a scenario with the reward with which agents that are paid each learn fastest.

    It is the difference reward, or where that is not defined the local one, by which agents pay for their own voltage,
    work and effort. On the presets ``PAID_ALONE`` it is the local one too.
    """
    if scenario.name in PAID_ALONE:
        return scenario.replace(reward="local")
    try:
        return scenario.replace(reward="difference")
    except ScenarioError:
        return scenario.replace(reward="local")


def decision_steps(scenario: Scenario) -> int:
    """Return the steps for which settings of power smoothing hold that agents choose, 1 without such agents."""
    smoothing = scenario.datacenters.smoothing
    if smoothing is None or smoothing.control != "agent":
        return 1
    steps = max(1, round(smoothing.change_every_s / scenario.dt_s))
    return steps if scenario.horizon % steps == 0 else 1

"""Functions from rows to actions as controllers, for policies of any library."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from dcgrid_env import Scenario, action_layout, under_own_control
from dcgrid_env.agents.training.row_form import Outputs, View, check_form, learning_form
from dcgrid_env.agents.training.row_views import Rows, make_rows
from dcgrid_env.baselines.equipment_agents import EquipmentAgents


class RowPolicy:
    """A controller from a function that acts on the rows of ``sb3_vec_env`` and ``training_env``.

    Parameters
    ----------
    function
        Returns actions of rows, (row, n_action) in [-1, 1], for their observations, (row, n_observation) float32. There
        may be any number of rows. Observations are not scaled: for a policy trained on ``envs = training_env(...)``,
        call ``envs.scaling`` on them first.
    view, outputs, nameplate
        Form of the rows in training, with the defaults of :func:`sb3_vec_env`.

    Raises
    ------
    ValueError
        For an unknown view or unknown outputs, or nameplate figures in a joint view.
    TypeError
        If ``function`` cannot be called.

    Examples
    --------
    >>> import dcgrid_env
    >>> from dcgrid_env.agents import RowPolicy
    >>> tuned_droop = RowPolicy(lambda rows: 0.0 * rows[:, :1], outputs="droop")
    >>> abs(dcgrid_env.score(tuned_droop, "ieee33-weak", seeds=range(2)).score.value) < 1e-3
    True
    """

    def __init__(
        self,
        function: Callable[[np.ndarray], Any],
        view: View | None = None,
        *,
        outputs: Outputs | None = None,
        nameplate: bool | None = None,
    ):
        check_form(view, outputs, nameplate)
        if not callable(function):
            raise TypeError(f"function is of type {type(function).__name__}; give a function of rows")
        self._function, self._nameplate = function, nameplate
        self._view: View | None = view
        self._outputs: Outputs | None = outputs

    def reset(self, env_info: Scenario) -> None:
        """Begin episodes; raise ValueError if the form does not apply to the scenario."""
        self.rows, self._layout = self._rows_on(env_info), action_layout(env_info)
        drives_all = self.rows.scenario.agents == env_info.agents
        self._equipment = None if drives_all else EquipmentAgents(env_info, keep_set_points=True)

    def act(self, observations: Any) -> Any:
        """Return actions in the form of the observations: a mapping of agents, or joint, (..., n_observation)."""
        if self._equipment is not None:
            return self._equipment.act(observations, self._joint)
        if isinstance(observations, Mapping):
            joint = np.concatenate([observations[agent] for agent in self.rows.scenario.agents], axis=-1)
            return self._layout.split(self._joint(joint))
        return self._joint(np.asarray(observations))

    def _rows_on(self, scenario: Scenario) -> Rows:
        """Return the rows of a scenario, with regulators and capacitor banks under own control unless it drives all."""
        form = learning_form(scenario, self._view, self._outputs, self._nameplate)
        on = scenario if form.view == "joint" else under_own_control(scenario, keep_set_points=True)
        return make_rows(on, form)

    def _joint(self, joint: np.ndarray) -> np.ndarray:
        action = self.rows.driven(joint.reshape(-1, joint.shape[-1]), self._acted)
        return action.reshape(*joint.shape[:-1], -1)

    def _acted(self, observations: np.ndarray) -> np.ndarray:
        actions = np.asarray(self._function(observations), np.float32)
        expected = (len(observations), self.rows.n_action)
        if actions.shape != expected:
            raise ValueError(f"function: returned actions of shape {actions.shape}; return {expected}")
        return actions.clip(-1.0, 1.0)

"""The spec that Gymnasium gives an environment, with a scenario and overrides of its fields as plain data."""

from __future__ import annotations

import dataclasses
from typing import Any

from gymnasium.envs.registration import EnvSpec, registry

from dcgrid_env.core.checked import Plain
from dcgrid_env.envs.time_limit import Horizon
from dcgrid_env.scenario.errors import ScenarioError
from dcgrid_env.scenario.scenario import Scenario
from dcgrid_env.scenario.serialization import refuse_objects, to_data


class PlainSpec:
    """Mixin of Gymnasium environments, placed before their base, that keeps a spec's keyword arguments as plain data.

    ``spec.to_json()`` is then complete, whatever objects the environment was made with. An object without a plain
    form, such as a recording made in Python, is unchanged, and ``to_json`` raises an error with its name. The spec's
    ``max_episode_steps`` is the horizon."""

    scenario: Scenario
    _spec: Any = None

    @property
    def spec(self) -> Any:
        """The environment's ``gymnasium.EnvSpec``, None unless ``gymnasium.make`` or ``make_vec`` made it."""
        return self._spec

    @spec.setter
    def spec(self, spec: Any) -> None:
        if spec is not None:
            self._refuse_time_limit(spec.id)
            kwargs = {
                name: _plain_value(value) for name, value in spec.kwargs.items() if not isinstance(value, Horizon)
            }
            fields = {field.name: getattr(spec, field.name) for field in dataclasses.fields(spec) if field.init}
            steps = Horizon(self.scenario.horizon)
            kind = EnvSpec if _is_plain(kwargs) else _WithObjects
            spec = kind(**fields | {"kwargs": kwargs, "max_episode_steps": steps, "additional_wrappers": ()})
            self._on_spec()
        self._spec = spec

    def _refuse_time_limit(self, gym_id: str) -> None:
        """Raise ScenarioError if the registration of an id has a time limit of another length than the horizon."""
        steps, horizon = getattr(registry.get(gym_id), "max_episode_steps", None), self.scenario.horizon
        if steps not in (None, horizon) and not isinstance(steps, Horizon):
            raise ScenarioError(
                f"{gym_id!r} is registered with max_episode_steps={steps} and its horizon is {horizon}, so what an "
                f"episode is charged at its end, such as work left over, would be wrong; register it with "
                f"kwargs={{'horizon': {steps}}} and without max_episode_steps"
            )

    def _on_spec(self) -> None:
        """Do what is due where Gymnasium has made the environment."""


class _WithObjects(EnvSpec):
    """Spec with keyword arguments that have no JSON form."""

    def to_json(self) -> str:
        """Raise a ScenarioError that names the argument, its type and the remedy."""
        for name, value in self.kwargs.items():
            refuse_objects(self.id, name, value)
        return super().to_json()


def _plain_value(value: Any) -> Plain:
    """Return a keyword argument in plain form; for a scenario, its preset's name or a mapping of its fields."""
    if not isinstance(value, Scenario):
        return to_data(value)
    return value.preset or {field.name: to_data(getattr(value, field.name)) for field in dataclasses.fields(value)}


def _is_plain(kwargs: dict[str, Any]) -> bool:
    try:
        refuse_objects("", "", kwargs)
    except ValueError:
        return False
    return True

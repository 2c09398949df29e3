"""The spec that Gymnasium gives an environment, with a scenario and overrides of its fields as plain data."""

from __future__ import annotations

import dataclasses
from typing import Any

from gymnasium.envs.registration import EnvSpec

from dcgrid_env.scenario.plain import refuse_objects, to_plain
from dcgrid_env.scenario.scenario import Scenario


class PlainSpec:
    """Mixed into Gymnasium environments, before their base: a spec given to them keeps its keyword arguments as plain
    data, so that ``spec.to_json()`` loses nothing whatever objects the environment was made with. An object without a
    plain form, a recording made in Python say, stays as it is, and ``to_json`` refuses it by its name."""

    _spec: Any = None

    @property
    def spec(self) -> Any:
        """The environment's ``gymnasium.EnvSpec``, None unless ``gymnasium.make`` or ``make_vec`` made it."""
        return self._spec

    @spec.setter
    def spec(self, spec: Any) -> None:
        if spec is not None:
            kwargs = {name: _plain(value) for name, value in spec.kwargs.items()}
            spec = dataclasses.replace(spec, kwargs=kwargs)
            if not _is_plain(kwargs):
                given = {field.name: getattr(spec, field.name) for field in dataclasses.fields(spec) if field.init}
                spec = _WithObjects(**given)
        self._spec = spec


class _WithObjects(EnvSpec):
    """A spec with keyword arguments that JSON cannot hold."""

    def to_json(self) -> str:
        """ScenarioError, naming the argument, its type and the remedy."""
        for name, value in self.kwargs.items():
            refuse_objects(self.id, name, value)
        return super().to_json()


def _plain(value: Any) -> Any:
    """The plain form of a keyword argument; of a scenario its preset's name, or a mapping of its fields."""
    if not isinstance(value, Scenario):
        return to_plain(value)
    return value.preset or {field.name: to_plain(getattr(value, field.name)) for field in dataclasses.fields(value)}


def _is_plain(kwargs: dict[str, Any]) -> bool:
    try:
        refuse_objects("", "", kwargs)
    except ValueError:
        return False
    return True

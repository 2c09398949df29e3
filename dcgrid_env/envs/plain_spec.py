"""The spec that Gymnasium gives an environment, with overrides of scenario fields as plain data."""

from __future__ import annotations

import dataclasses
from typing import Any

from dcgrid_env.scenario.plain import to_plain


class PlainSpec:
    """Mixed into Gymnasium environments, before their base: a spec given to them keeps its keyword arguments as plain
    data, so that ``spec.to_json()`` loses nothing whatever objects the environment was made with. An object without a
    plain form, a recording say, stays as it is."""

    _spec: Any = None

    @property
    def spec(self) -> Any:
        """The environment's ``gymnasium.EnvSpec``, None unless ``gymnasium.make`` or ``make_vec`` made it."""
        return self._spec

    @spec.setter
    def spec(self, spec: Any) -> None:
        if spec is not None:
            kwargs = {name: to_plain(value) for name, value in spec.kwargs.items()}
            spec = dataclasses.replace(spec, kwargs=kwargs)
        self._spec = spec

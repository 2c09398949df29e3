"""Steps in an episode as Gymnasium and PettingZoo set them, which equal the scenario's horizon.

``gymnasium.make`` ends an episode at ``max_episode_steps`` in a wrapper, TimeLimit, and does not pass the number to the
environment. Work left over at that step would never be charged, and deferral would be free (docs/decisions/0007). The
specs of this package therefore have :class:`HorizonLimit` as a wrapper behind TimeLimit.
"""

from __future__ import annotations

import dataclasses
from numbers import Integral
from typing import Any

import gymnasium
import numpy as np
from gymnasium.envs.registration import EnvSpec, WrapperSpec
from gymnasium.wrappers import TimeLimit

from dcgrid_env.scenario.errors import ScenarioError


class Horizon(int):
    """``max_episode_steps`` of a spec that follows from its scenario, unlike a number that a user gives."""


def with_horizon(overrides: dict[str, Any], name: str, steps: int | None) -> dict[str, Any]:
    """Return a scenario's overrides with ``steps``, the argument called ``name``, as the horizon.

    They are unchanged for None, for a :class:`Horizon`, and for Gymnasium's -1, no limit. ScenarioError for other
    numbers below 1, and if the overrides contain another horizon.
    """
    if steps is None or isinstance(steps, Horizon) or (steps == -1 and name == "max_episode_steps"):
        return overrides
    if isinstance(steps, bool) or not isinstance(steps, Integral) or steps < 1:
        raise ScenarioError(f"{name} is {steps!r}; give a whole number of at least 1")
    horizon = overrides.get("horizon", steps)
    if isinstance(horizon, bool) or not isinstance(horizon, Integral) or horizon != steps:
        raise ScenarioError(
            f"{name} is {steps} and horizon is {horizon!r}, but both are the number of steps in an episode; give one, "
            "or the same number for both"
        )
    return overrides | {"horizon": int(steps)}


class HorizonLimit(gymnasium.Wrapper[np.ndarray, np.ndarray, np.ndarray, np.ndarray]):
    """Replace Gymnasium's TimeLimit by an environment whose horizon is the limit.

    Parameters
    ----------
    env
        The environment that ``gymnasium.make`` made, in a TimeLimit unless it was made without a limit.
    horizon
        Steps in an episode by the scenario of the spec: a limit of that many is the spec's, and changes nothing.

    Raises
    ------
    ScenarioError
        If the environment was made with another ``horizon`` than the limit.
    """

    def __init__(self, env: gymnasium.Env[np.ndarray, np.ndarray], horizon: int | None = None):
        if isinstance(env, TimeLimit):
            limit, env = env._max_episode_steps, env.env
            spec: Any = env.spec
            kwargs = spec.kwargs if limit == horizon else with_horizon(spec.kwargs, "max_episode_steps", limit)
            if kwargs is not spec.kwargs and limit != spec.max_episode_steps:
                env.close()
                env = gymnasium.make(dataclasses.replace(spec, kwargs=kwargs), max_episode_steps=-1)
        super().__init__(env)

    @property
    def spec(self) -> EnvSpec | None:
        """The environment's spec, from which ``gymnasium.make`` and ``make_vec`` make the same."""
        spec = self.env.spec
        if spec is None or spec.max_episode_steps is None:
            return spec
        steps = int(spec.max_episode_steps)
        return dataclasses.replace(
            spec, max_episode_steps=steps, additional_wrappers=behind_time_limit({"horizon": steps})
        )


class _BehindTimeLimit(tuple[WrapperSpec, ...]):
    """Wrappers of a spec that ``gymnasium.make`` applies, and that do not keep ``make_vec`` from the native batch.

    ``make_vec`` refuses a batch for a spec with a number of wrappers, because it would not apply them. A batch takes
    ``max_episode_steps`` itself and needs none, so the number is 0.
    """

    def __len__(self) -> int:
        return 0


def behind_time_limit(kwargs: dict[str, Any]) -> tuple[WrapperSpec, ...]:
    """Return ``additional_wrappers`` of the spec of a single environment, with arguments of :class:`HorizonLimit`."""
    return _BehindTimeLimit((WrapperSpec("HorizonLimit", f"{__name__}:HorizonLimit", kwargs),))

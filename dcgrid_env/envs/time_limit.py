"""Steps in an episode as Gymnasium and PettingZoo set them, which must equal the scenario's horizon.

``gymnasium.make`` ends an episode at ``max_episode_steps`` in a wrapper, TimeLimit, and does not pass the number to the
environment. Work left over at that step would never be charged, and deferral would be free (docs/decisions/0007).
"""

from __future__ import annotations

import sys
from numbers import Integral
from types import FrameType
from typing import Any

from gymnasium.wrappers import TimeLimit

from dcgrid_env.scenario.errors import ScenarioError


def with_horizon(overrides: dict[str, Any], name: str, steps: int | None) -> dict[str, Any]:
    """Return a scenario's overrides with ``steps``, the argument called ``name``, as the horizon; unchanged for None.

    Gymnasium's -1, no limit, keeps the scenario's horizon too. ScenarioError for other numbers below 1, and if the
    overrides contain another horizon.
    """
    if steps is None or (steps == -1 and name == "max_episode_steps"):
        return overrides
    if isinstance(steps, bool) or not isinstance(steps, Integral) or steps < 1:
        raise ScenarioError(f"{name} is {steps!r}; give a whole number of at least 1")
    horizon = overrides.get("horizon", steps)
    if isinstance(horizon, bool) or not isinstance(horizon, Integral) or horizon != steps:
        raise ScenarioError(
            f"{name} is {steps} and horizon is {horizon!r}, but both are the number of steps in an episode; give one"
        )
    return overrides | {"horizon": int(steps)}


def refuse_shorter_limit(env: Any) -> None:
    """Raise ScenarioError if this reset was called through a TimeLimit that ends ``env`` before its horizon."""
    frame: FrameType | None = sys._getframe(1)
    while frame is not None:
        if frame.f_code is TimeLimit.reset.__code__:
            limit: Any = frame.f_locals["self"]
            steps = limit._max_episode_steps
            if steps < env.scenario.horizon and limit.unwrapped is env:
                raise ScenarioError(
                    f"a TimeLimit of {steps} steps would end the episode before the scenario's horizon of "
                    f"{env.scenario.horizon}, and work left over would never be charged; leave max_episode_steps or "
                    f"the wrapper out and make the environment with horizon={steps}"
                )
        frame = frame.f_back

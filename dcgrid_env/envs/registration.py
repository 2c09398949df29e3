"""Registers the presets' environments with Gymnasium and, where its release has a registry, with PettingZoo."""

from __future__ import annotations

import gymnasium
import pettingzoo
from gymnasium.envs.registration import EnvSpec

from dcgrid_env.envs.time_limit import Horizon, behind_time_limit
from dcgrid_env.scenario.presets import IDS, make_scenario


class ScenarioSpec(EnvSpec):
    """Spec whose ``max_episode_steps`` is the horizon of its scenario, which is made when the number is needed."""

    @property
    def max_episode_steps(self) -> int | None:
        """Steps in an episode."""
        for name in ("max_episode_steps", "horizon"):
            if self.kwargs.get(name) not in (None, -1):
                return Horizon(self.kwargs[name])
        return Horizon(make_scenario(self.kwargs.get("scenario") or IDS[self.id]).horizon)

    @max_episode_steps.setter
    def max_episode_steps(self, steps: int | None) -> None:  # pyright: ignore[reportIncompatibleVariableOverride]
        """Ignore the default that EnvSpec sets."""


def register() -> None:
    """Register an environment for each id of ``IDS``; those that are registered already are unchanged."""
    for gym_id, scenario in IDS.items():
        if gym_id not in gymnasium.registry:
            gymnasium.registry[gym_id] = ScenarioSpec(
                gym_id,
                entry_point="dcgrid_env.envs.single:DcgridEnv",
                vector_entry_point="dcgrid_env.envs.vector:DcgridVectorEnv",
                # The environment checks its own actions, with better messages; the generic checker costs a third of
                # the step. gymnasium.utils.env_checker.check_env passes and is among the tests.
                disable_env_checker=True,
                additional_wrappers=behind_time_limit({}),
                kwargs={"scenario": scenario},
            )
        if hasattr(pettingzoo, "register") and gym_id not in pettingzoo.parallel_registry:
            pettingzoo.register("parallel", gym_id, "dcgrid_env:parallel_env", kwargs={"scenario": scenario})
            pettingzoo.register("aec", gym_id, "dcgrid_env:env", kwargs={"scenario": scenario})

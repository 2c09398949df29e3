"""Registers the presets' environments with Gymnasium and, where its release has a registry, with PettingZoo."""

import gymnasium
import pettingzoo

from dcgrid_env.scenario.presets import IDS


def register() -> None:
    """Register an environment for each id of ``IDS``; those that are registered already are unchanged."""
    for gym_id, scenario in IDS.items():
        if gym_id not in gymnasium.registry:
            gymnasium.register(
                gym_id,
                entry_point="dcgrid_env.envs.single:DcgridEnv",
                vector_entry_point="dcgrid_env.envs.vector:DcgridVectorEnv",
                # The environment checks its own actions, with better messages; the generic checker costs a third of
                # the step. gymnasium.utils.env_checker.check_env passes and is among the tests.
                disable_env_checker=True,
                kwargs={"scenario": scenario},
            )
        if hasattr(pettingzoo, "register") and gym_id not in pettingzoo.parallel_registry:
            pettingzoo.register("parallel", gym_id, "dcgrid_env:parallel_env", kwargs={"scenario": scenario})
            pettingzoo.register("aec", gym_id, "dcgrid_env:env", kwargs={"scenario": scenario})

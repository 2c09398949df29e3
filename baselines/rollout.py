"""Run a controller through episodes of a scenario, many at once on the native batch."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from dcgrid_env import DcgridVectorEnv, Recorder, Scenario
from dcgrid_env.baselines.controller import Controller, Placed


def rollout(
    scenario: Scenario, controller: Controller, seeds: Sequence[int], on_step: Callable[[], None] | None = None
) -> Recorder:
    """Drive one episode for each seed to its end; lane i of the recorder is seed i.

    Parameters
    ----------
    scenario
        What to run; its split says which episodes the seeds mean.
    controller
        Reset once, told where the agents stand if it is :class:`Placed`, then asked at each step.
    seeds
        One lane each.
    on_step
        Called after each step (for progress).

    Raises
    ------
    ValueError
        Where the controller returns something that is no action, naming the agent.
    """
    # Actions and metrics are those of the team, whoever is paid what.
    scenario = scenario.replace(reward="shared", observe=getattr(controller, "observe", scenario.observe))
    env = DcgridVectorEnv(len(seeds), scenario)
    observations, info = env.reset(seed=list(seeds))
    recorder = Recorder(scenario, env.transition)
    controller.reset(scenario)
    if isinstance(controller, Placed):
        index = scenario.feeder.index
        controller.place(np.array([[index(bus) for bus in info[f"bus_{agent}"]] for agent in scenario.agents]).T)
    while not recorder.over:
        observations, *_ = env.step(controller.act(observations))
        recorder.add(env.transition)
        if on_step is not None:
            on_step()
    env.close()
    return recorder

"""Run a controller through episodes of a scenario, many at once on the native batch."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from dcgrid_env import DcgridVectorEnv, Recorder, Scenario
from dcgrid_env.baselines.controller import Controller


def rollout(
    scenario: Scenario, controller: Controller, seeds: Sequence[int], on_step: Callable[[], None] | None = None
) -> Recorder:
    """Drive one episode for each seed to its end; lane i of the recorder is seed i.

    Parameters
    ----------
    scenario
        What to run; its split says which episodes the seeds mean.
    controller
        Reset once, then asked at each step.
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
    env = DcgridVectorEnv(len(seeds), scenario.replace(reward="shared"))
    observations, _ = env.reset(seed=list(seeds))
    recorder = Recorder(scenario, env.transition)
    controller.reset(scenario)
    while not recorder.over:
        observations, *_ = env.step(controller.act(observations))
        recorder.add(env.transition)
        if on_step is not None:
            on_step()
    env.close()
    return recorder

"""Run a controller through episodes of a scenario, many at once on the native batch."""

from __future__ import annotations

from collections.abc import Callable, Generator, Mapping, Sequence
from functools import partial
from itertools import count
from typing import Any, TypeVar

import numpy as np

from dcgrid_env import (
    ActionError,
    DcgridVectorEnv,
    JoinedRecorder,
    PartSink,
    Recorder,
    Scenario,
    StreamingRecorder,
)
from dcgrid_env.baselines.controller import Controller, NeedsPlacement
from dcgrid_env.baselines.user_code import OwnCodeError, described, one_line, place

AnyRecorder = TypeVar("AnyRecorder", Recorder, StreamingRecorder)


class ControllerError(OwnCodeError):
    """A controller that fails, or refuses the scenario; what it raised is the cause.

    Parameters
    ----------
    name
        What the controller is called.
    during
        ``reset``, ``place`` or ``act``.
    cause
        What was raised there.
    refuses
        The scenario's name where the controller says, by a ValueError in ``reset``, that it cannot drive it.
    """

    def __init__(self, name: str, during: str, cause: BaseException, refuses: str | None = None):
        plain = isinstance(cause, ActionError) or refuses is not None  # what tells all without its kind
        at = place(cause)
        self.refuses, self.reason = refuses, one_line(cause) if plain else described(cause)
        self.where, self.traced = f"{during}{at}", not plain
        doing = f"fails in {self.where}" if refuses is None else f"cannot drive {refuses}{at}"
        super().__init__(f"controller {name!r} {doing}: {self.reason}")


def rollout(
    scenario: Scenario,
    controller: Controller,
    seeds: Sequence[int],
    on_step: Callable[[], None] | None = None,
    name: str | None = None,
) -> Recorder:
    """Drive one episode for each seed to its end; environment i of the recorder has seed i.

    On random feeders a controller that is given buses is reset for each feeder in turn, with the scenario on it.

    Parameters
    ----------
    scenario
        What to run; its split says which episodes the seeds mean.
    controller
        Reset once, given the agents' buses if it is :class:`NeedsPlacement`, then asked at each step.
    seeds
        One environment each.
    on_step
        Called after each step (for progress).
    name
        What errors call the controller; its class by default.

    Raises
    ------
    ControllerError
        A ValueError, where the controller raises anything, refuses the scenario or gives what is no action.
    """
    groups = scenario.members(seeds) if isinstance(controller, NeedsPlacement) else [(scenario, np.arange(len(seeds)))]
    groups = [(as_driven(on, controller), env_indices) for on, env_indices in groups]
    if len(groups) == 1:
        return _driven(groups[0][0], controller, seeds, partial(Recorder, seeds=seeds), on_step, name)
    steps, every = count(1), len(groups)

    def on_any_step() -> None:
        if on_step is not None and next(steps) % every == 0:
            on_step()

    parts = []
    for member, env_indices in groups:
        member_seeds = [seeds[i] for i in env_indices.tolist()]
        parts.append(
            (
                env_indices,
                _driven(member, controller, member_seeds, partial(Recorder, seeds=member_seeds), on_any_step, name),
            )
        )
    return JoinedRecorder(scenario, parts)


def streaming_rollout(
    scenario: Scenario,
    controller: Controller,
    seeds: Sequence[int],
    sinks: Sequence[PartSink] = (),
    on_step: Callable[[], None] | None = None,
    name: str | None = None,
) -> StreamingRecorder:
    """Drive episodes of any length, in memory that does not grow with it; else as :func:`rollout`.

    Parameters
    ----------
    scenario, controller, seeds, on_step, name
        See :func:`rollout`.
    sinks
        What is given the course as it comes, part by part, :class:`ParquetCourse` for instance.

    Raises
    ------
    ControllerError
        Where :func:`rollout` raises it.
    ScenarioError
        Where the seeds are on different random feeders.
    """
    scenario = as_driven(scenario.member(seeds), controller)

    def recorder(scenario: Scenario, begun: Any) -> StreamingRecorder:
        return StreamingRecorder(scenario, begun, sinks)

    return _driven(scenario, controller, seeds, recorder, on_step, name)


def _driven(
    scenario: Scenario,
    controller: Controller,
    seeds: Sequence[int],
    record: Callable[[Scenario, Any], AnyRecorder],
    on_step: Callable[[], None] | None,
    name: str | None,
) -> AnyRecorder:
    """Drive the episodes into a recorder that ``record`` makes of scenario and first transition."""
    steps = transitions(scenario, controller, seeds, name)
    recorder = record(scenario, next(steps))
    while not recorder.over:
        recorder.add(next(steps))
        if on_step is not None:
            on_step()
    steps.close()
    return recorder


def as_driven(scenario: Scenario, controller: Controller) -> Scenario:
    """The scenario with the scope of observation that a controller needs.

    Actions and metrics are those of the team, whoever is paid what.
    """
    reward, observe = "shared", getattr(controller, "observe", scenario.sensing.observe)
    if (scenario.cost.reward, scenario.sensing.observe) == (reward, observe):
        return scenario
    return scenario.replace(reward=reward, observe=observe)


def transitions(
    scenario: Scenario,
    controller: Controller,
    seeds: Sequence[int],
    name: str | None = None,
    options: Mapping[str, Any] | None = None,
) -> Generator[Any, None, None]:
    """Drive episodes; yield the transitions of all environments (``DcgridVectorEnv.transition``), without an end.

    Parameters
    ----------
    scenario
        What :func:`as_driven` gives.
    controller, seeds, name
        See :func:`rollout`.
    options
        What the reset is given of the episodes, see ``DcgridVectorEnv.reset``.

    Raises
    ------
    ControllerError
        See :func:`rollout`.
    """
    called = name or type(controller).__name__
    env = DcgridVectorEnv(len(seeds), scenario, info="none")
    observations, _ = env.reset(seed=list(seeds), options=dict(options or {}))
    _asked(called, "reset", controller.reset, scenario, refuses=scenario.name)
    if isinstance(controller, NeedsPlacement):
        index = scenario.feeder.index
        buses = np.array([[index(bus) for bus in bus_ids] for bus_ids in env.buses()])
        _asked(called, "place", controller.place, buses)
    try:
        yield env.transition
        while True:
            action = _asked(called, "act", action_of, controller, observations)
            try:
                observations, *_ = env.step(action)
            except ActionError as error:
                raise ControllerError(called, "act", error) from error
            yield env.transition
    finally:
        env.close()


def _asked(called: str, during: str, method: Callable[..., Any], *given: Any, refuses: str | None = None) -> Any:
    """What a controller's method returns; whatever it raises is a ControllerError, but for Ctrl-C."""
    try:
        return method(*given)
    except (Exception, SystemExit) as error:
        refused = refuses if isinstance(error, ValueError) else None
        raise ControllerError(called, during, error, refused) from error


def action_of(controller: Controller, observations: np.ndarray) -> Any:
    """The action for observations, a tensor of another library as an array.

    A tensor that records gradients is refused rather than detached: all that led to it would be kept in memory step
    after step, and no derivative ever comes back through a rollout.
    """
    action = controller.act(observations)
    if action is None:
        raise ActionError("act returned None; return the action")
    if getattr(action, "requires_grad", False):
        raise ActionError(
            "the action is a tensor that records gradients, which a rollout does not follow; act under "
            "torch.no_grad() or return action.detach() (TensorEnv is what gives derivatives)"
        )
    if hasattr(action, "detach"):
        action = action.detach().cpu()
    if hasattr(action, "dtype") and np.iscomplexobj(action):
        raise ActionError("the action is complex; give real numbers in [-1, 1]")
    return action

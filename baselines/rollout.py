"""Run a controller through episodes of a scenario, in parallel on the native batch."""

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
from dcgrid_env.baselines.controller import Controller, NeedsPlacement, NeedsRegulators
from dcgrid_env.baselines.user_code import OwnCodeError, described, one_line, place

AnyRecorder = TypeVar("AnyRecorder", Recorder, StreamingRecorder)


class ControllerError(OwnCodeError):
    """Error of a controller that fails or refuses the scenario; the exception it raised is the cause.

    Parameters
    ----------
    name
        Name of the controller.
    during
        Method that failed: ``reset``, ``place``, ``measure`` or ``act``.
    cause
        The exception.
    refuses
        Name of the scenario if the controller refused it by a ValueError in ``reset``, else None.
    """

    def __init__(self, name: str, during: str, cause: BaseException, refuses: str | None = None):
        is_clear = isinstance(cause, ActionError) or refuses is not None  # clear without the exception's type
        location = place(cause)
        self.refuses, self.reason = refuses, one_line(cause) if is_clear else described(cause)
        self.where, self.traced = f"{during}{location}", not is_clear
        doing = f"fails in {self.where}" if refuses is None else f"cannot drive {refuses}{location}"
        super().__init__(f"controller {name!r} {doing}: {self.reason}")


def rollout(
    scenario: Scenario,
    controller: Controller,
    seeds: Sequence[int],
    on_step: Callable[[], None] | None = None,
    name: str | None = None,
) -> Recorder:
    """Drive one episode for each seed to its end; environment i of the recorder has seed i.

    On random feeders, a controller that needs buses is reset for each feeder in turn, with the scenario on that feeder.

    Parameters
    ----------
    scenario
        Scenario to run; its split determines the episode of each seed.
    controller
        Controller to run. It is reset once and receives the agents' buses if it is :class:`NeedsPlacement`. Then
        ``act`` is called at each step, after ``measure`` if the controller is :class:`NeedsRegulators`.
    seeds
        Seeds of the episodes, one environment each.
    on_step
        Function called after each step, for progress.
    name
        Name of the controller in errors; its class by default.

    Raises
    ------
    ControllerError
        A ValueError, if the controller raises an exception, refuses the scenario or returns an invalid action.
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
    """Drive episodes of any length in constant memory; otherwise like :func:`rollout`.

    Parameters
    ----------
    scenario, controller, seeds, on_step, name
        See :func:`rollout`.
    sinks
        Receivers of the time series, part by part during the run, for example :class:`ParquetCourse`.

    Raises
    ------
    ControllerError
        If :func:`rollout` would raise it.
    ScenarioError
        If the seeds are on different random feeders.
    """
    scenario = as_driven(scenario.member(seeds), controller)

    def recorder(scenario: Scenario, initial: Any) -> StreamingRecorder:
        return StreamingRecorder(scenario, initial, sinks)

    return _driven(scenario, controller, seeds, recorder, on_step, name)


def _driven(
    scenario: Scenario,
    controller: Controller,
    seeds: Sequence[int],
    record: Callable[[Scenario, Any], AnyRecorder],
    on_step: Callable[[], None] | None,
    name: str | None,
) -> AnyRecorder:
    """Drive the episodes into a recorder that ``record`` makes from the scenario and the first transition."""
    steps = transitions(scenario, controller, seeds, name)
    recorder = record(scenario, next(steps))
    while not recorder.over:
        recorder.add(next(steps))
        if on_step is not None:
            on_step()
    steps.close()
    return recorder


def as_driven(scenario: Scenario, controller: Controller) -> Scenario:
    """Return the scenario with the scope of observation that a controller needs, and the shared reward.

    Actions and metrics do not depend on how the reward is divided among agents.
    """
    observe = getattr(controller, "observe", scenario.sensing.observe)
    if (scenario.cost.reward, scenario.sensing.observe) == ("shared", observe):
        return scenario
    return scenario.paid_as_team().replace(observe=observe)


def transitions(
    scenario: Scenario,
    controller: Controller,
    seeds: Sequence[int],
    name: str | None = None,
    options: Mapping[str, Any] | None = None,
) -> Generator[Any, None, None]:
    """Drive episodes and yield the transitions of all environments (``DcgridVectorEnv.transition``) without an end.

    Parameters
    ----------
    scenario
        Result of :func:`as_driven`.
    controller, seeds, name
        See :func:`rollout`.
    options
        Options of the reset, see ``DcgridVectorEnv.reset``.

    Raises
    ------
    ControllerError
        See :func:`rollout`.
    """
    called = name or type(controller).__name__
    env = DcgridVectorEnv(len(seeds), scenario, info="none")
    observations, _ = env.reset(seed=list(seeds), options=dict(options or {}))
    _call(called, "reset", controller.reset, scenario, refuses=scenario.name)
    if isinstance(controller, NeedsPlacement):
        index = scenario.feeder.index
        buses = np.array([[index(bus) for bus in bus_ids] for bus_ids in env.buses()])
        _call(called, "place", controller.place, buses)
    try:
        yield env.transition
        while True:
            phases = env.transition.state.three_phase
            if isinstance(controller, NeedsRegulators) and phases is not None:
                _call(called, "measure", controller.measure, phases.equipment.regulators)
            action = _call(called, "act", action_of, controller, observations)
            try:
                observations, *_ = env.step(action)
            except ActionError as error:
                raise ControllerError(called, "act", error) from error
            yield env.transition
    finally:
        env.close()


def _call(called: str, during: str, method: Callable[..., Any], *arguments: Any, refuses: str | None = None) -> Any:
    """Call a controller's method; convert every exception except a keyboard interrupt to a ControllerError."""
    try:
        return method(*arguments)
    except (Exception, SystemExit) as error:
        refused = refuses if isinstance(error, ValueError) else None
        raise ControllerError(called, during, error, refused) from error


def action_of(controller: Controller, observations: np.ndarray) -> Any:
    """Return the action for observations, with tensors of other libraries converted to arrays.

    A tensor that records gradients is refused and not detached: its graph would stay in memory step after step, and a
    rollout does not return derivatives.
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

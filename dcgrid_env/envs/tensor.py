"""A batch of episodes as arrays of any kind: for gradients through the grid, and for devices other than the CPU.

The episodes are those of the other environments, drawn by the same code. Exogenous series are drawn when they begin
and moved to the device once. Every step is ``dynamics.step``, so that a cost has a derivative by every action
that led to it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager, nullcontext
from typing import Any, NamedTuple

import numpy as np
from array_api_compat import is_array_api_obj, is_torch_array

from dcgrid_env.core.arrays import Array, all_true, as_like, namespace
from dcgrid_env.core.seeds import whole_seed
from dcgrid_env.devices import Work
from dcgrid_env.devices.ride_through.connection_surrogate import TripWidths
from dcgrid_env.engine.cost import observation, reward
from dcgrid_env.engine.cost.measurement import measure, measurement_noise, remembered
from dcgrid_env.engine.physics import connections, dynamics
from dcgrid_env.engine.physics.actions import action_layout
from dcgrid_env.engine.physics.connections import Placement
from dcgrid_env.engine.physics.state import Exogenous, State
from dcgrid_env.powerflow import PowerFlowError
from dcgrid_env.scenario.presets import make_scenario
from dcgrid_env.scenario.scenario import Scenario


class TensorStep(NamedTuple):
    """Result of a step; arrays over environments."""

    observation: Array
    """Joint observation, (row, n_observation), not cut to its bounds."""
    cost_j: Array
    """The step's share of J times T, (row,); 0 once the power flow has had no solution and all has been charged."""
    costs: reward.Costs
    """Its weighted terms, (row,) each."""
    state: State


NOT_SERIES = ("nodes", "legs", "trip_widths", "to_draw")
"""Fields of ``Exogenous`` that are the same in all steps of an episode, or None."""


class Outside(NamedTuple):
    """Exogenous series of some episodes, (0 .. T, episode, ..) each."""

    inputs: dict[str, Array | None]
    """Fields of ``Exogenous`` by name. The work has one step more: the preview at the end."""
    noise_pu: Array | None
    """Noise of the measurements."""

    def map(self, function: Callable[[Array], Array]) -> Outside:
        """The series with every array put through a function."""
        inputs = {name: None if series is None else function(series) for name, series in self.inputs.items()}
        return Outside(inputs, None if self.noise_pu is None else function(self.noise_pu))


class TensorEnv:
    """Episodes of a scenario in step with each other, differentiable where the arrays are.

    On the CPU, steps and their derivative run torch on one thread, and the power flow on ``DCGRID_NUM_THREADS``.

    Parameters
    ----------
    scenario
        A scenario or the name of one.
    like
        An array of the wanted kind, precision and device: ``torch.empty(0, device="cuda")``. float32 is solved to
        1e-2 kVA, float64 to 1e-4 kVA.
    trip_widths
        Widths of a smooth surrogate that gives what trips and returns a derivative, values as without it
        (``devices.ride_through.connection_surrogate``); None for no derivative. Tensors alone have one.
    **overrides
        Fields of the scenario.
    """

    def __init__(
        self,
        scenario: str | Scenario = "ieee123",
        *,
        like: Array,
        trip_widths: TripWidths | None = None,
        **overrides: object,
    ):
        if not _is_floating_array(like):
            raise ValueError(
                f"like is {like!r}; give an array of float32 or float64, such as numpy.empty(0) or torch.empty(0)"
            )
        if trip_widths is not None:
            trip_widths.check()
        self.scenario = make_scenario(scenario, **overrides)
        self.like, self._trip_widths = like, None if isinstance(like, np.ndarray) else trip_widths
        self._on = self.scenario  # on the feeder of the episodes, which reset says where feeders are random
        self.step_number = self.scenario.horizon  # over, until reset

    @property
    def over(self) -> bool:
        """Whether the horizon is reached."""
        return self.step_number >= self.scenario.horizon

    def reset(self, seeds: Sequence[int] | np.ndarray, copies: int = 1) -> Array:
        """Begin the first episode of each seed and return the joint observation, (row, n_observation).

        ``copies`` is the number of environments for each episode: environment i has that of seeds[i % len(seeds)].
        On random feeders, all episodes must be on the same feeder. ValueError for no episode, for seeds or copies
        that are not whole numbers, and for episodes on several feeders.
        """
        if not isinstance(seeds, Sequence | np.ndarray) or isinstance(seeds, str):
            raise ValueError(f"seeds is {seeds!r}; give a list of whole numbers of at least 0, one for each episode")
        if not isinstance(copies, int | np.integer) or isinstance(copies, bool):
            raise ValueError(f"copies is {copies!r}; give a whole number of at least 1")
        if not len(seeds) or copies < 1:
            raise ValueError(f"{len(seeds)} seeds and {copies} copies; give at least 1 of each")
        self._on = self.scenario.member(seeds)
        outside, buses = drawn_outside(self._on, np.array([whole_seed(seed) % 2**64 for seed in seeds], np.uint64))
        self._outside = outside.map(lambda series: as_like(series, self.like))
        episode = np.arange(len(buses) * copies) % len(buses)
        self._copied = None if copies == 1 else self._index(episode)
        placed = connections.placement(self._on, buses[episode])
        self._placed = Placement(
            *(as_like(distance, self.like) for distance in (placed.r, placed.x)),
            *map(self._index, (placed.nodes, placed.legs, placed.nearest)),
        )
        self.step_number = 0
        with self._torch_threads():
            self.state, _ = dynamics.initial_state(self._on, self._exogenous())
            self._measured = (self._measure(),) * remembered(self.scenario)
            self._due = as_like(np.ones(len(episode)), self.like)
            return self._observe()

    def step(self, action: Array) -> TensorStep:
        """Advance every environment by joint actions (row, n_action) in [-1, 1], arrays of the kind of ``like``.

        RuntimeError once the episodes are over; ValueError for actions of another kind, precision, device or shape, or
        that are not finite.
        """
        if self.over:
            raise RuntimeError("the episodes are over or have not begun; call reset()")
        self._check_action(action)
        with self._torch_threads():
            return self._stepped(action)

    def _stepped(self, action: Array) -> TensorStep:
        self.step_number += 1
        s, due = self._on, self._due
        try:
            self.state, grid = dynamics.step(s, self.state, action, self._exogenous())
        except PowerFlowError:
            self.step_number -= 1
            self._check_finite(action)
            raise
        self._measured = (*self._measured[1:], self._measure())
        costs = reward.team_costs(s, self.state, grid.solution, float(self.over))
        if not all_true(grid.solution.converged):
            xp = namespace(due)
            costs = reward.charged(s, costs, xp.full_like(due, self.step_number), grid.solution.converged)
            self._due = due * xp.astype(grid.solution.converged, due.dtype)
        if not all_true(due > 0.0):
            costs = costs._make(term * due for term in costs)
        return TensorStep(self._observe(), reward.total(costs), costs, self.state)

    def cut(self) -> None:
        """Detach the state from earlier steps: derivatives of later costs stop here (torch tensors)."""
        self.state = self.state.map(lambda array: array.detach())
        self._measured = tuple(a.detach() for a in self._measured)

    def _torch_threads(self) -> AbstractContextManager[None]:
        """Use one torch thread on the CPU, in addition to the power flow's; keep the setting on other devices."""
        if not is_torch_array(self.like) or self.like.device.type != "cpu":
            return nullcontext()
        from dcgrid_env.core.torch_threads import one_torch_thread  # imports torch

        return one_torch_thread()

    def _check_action(self, action: Array) -> None:
        like = self.like
        want = (len(self._due), action_layout(self.scenario).n)
        if not _fits(action, like):
            received = _kind(action) if is_array_api_obj(action) else repr(action)
            raise ValueError(f"the action is {received}; it must be as like is, {_kind(like)}")
        if tuple(action.shape) != want:
            raise ValueError(f"the action has shape {tuple(action.shape)}; it must be {want}: environments, actuators")

    def _check_finite(self, action: Array) -> None:
        xp = namespace(action)
        where = xp.nonzero(~xp.isfinite(action))
        if len(where[0]):
            env_index, entry = (int(i[0]) for i in where)
            raise ValueError(
                f"the action of environment {env_index} is {action[env_index, entry].item()} at {entry}; "
                "give finite numbers"
            )

    def _now(self, field: Array | None, ahead: int = 0) -> Array | None:
        if field is None:
            return None
        now = field[self.step_number + ahead]
        return now if self._copied is None else now[self._copied]

    def _exogenous(self) -> Exogenous:
        inputs: dict[str, Any] = {name: self._now(series) for name, series in self._outside.inputs.items()}
        return Exogenous(**inputs, nodes=self._placed.nodes, legs=self._placed.legs, trip_widths=self._trip_widths)

    def _measure(self) -> Array:
        return measure(self._on, self.state, self._now(self._outside.noise_pu))

    def _observe(self) -> Array:
        work = Work(*(self._now(self._outside.inputs[name], 1) for name in ("p_ref_kw", "compute_share")))
        next_input = [work if device.input == "workload" else None for device in self.scenario.devices]
        return observation.observe(self._on, self.state, self._placed, next_input, self._measured[1], self._measured[0])

    def _index(self, positions: np.ndarray) -> Array:
        """Return positions as integers of the wanted kind, on the wanted device."""
        if isinstance(self.like, np.ndarray):
            return positions
        return namespace(self.like).asarray(positions.copy(), device=self.like.device)


def _is_floating_array(values: object) -> bool:
    """Return whether ``values`` is an array of float32 or float64, and neither a number nor a masked array."""
    if not is_array_api_obj(values) or isinstance(values, np.generic | np.ma.MaskedArray):
        return False
    array: Array = values
    return str(array.dtype).rpartition(".")[2] in ("float32", "float64")


def _fits(action: Array, like: Array) -> bool:
    """Return whether an action has the kind, precision and device of ``like``; all NumPy floats match."""
    if isinstance(like, np.ndarray):
        return type(action) is np.ndarray and action.dtype.kind == "f"
    same = (getattr(action, "dtype", None), getattr(action, "device", None)) == (like.dtype, like.device)
    return same and is_array_api_obj(action)


def _kind(values: Array) -> str:
    if not isinstance(values, np.ndarray):
        return f"a tensor of {values.dtype} on {values.device}"
    masked = isinstance(values, np.ma.MaskedArray)
    return f"a {'masked' if masked else 'NumPy'} array of {'floats' if values.dtype.kind == 'f' else values.dtype}"


def drawn_outside(scenario: Scenario, seeds: np.ndarray) -> tuple[Outside, np.ndarray]:
    """Return the exogenous series of the first episode of each seed, and the positions of the agents' buses."""
    from dcgrid_env.engine.exogenous import episode  # brings the compiler with it, so not on import

    s = scenario
    drawn = episode.draw(s, seeds, np.zeros_like(seeds))
    steps, noise_pu = [], []
    for step, outside in episode.unroll(s, drawn):
        steps.append(outside)
        noise = measurement_noise(s, drawn.key, step)
        if noise is not None:
            noise_pu.append(noise)
    after = np.full(len(seeds), s.horizon + 1)

    def stacked(name: str, last: np.ndarray | None = None) -> np.ndarray | None:
        rows = [getattr(outside, name) for outside in steps]
        if rows[0] is None:
            return None
        return np.stack(rows if last is None else [*rows, last])

    preview = {
        "p_ref_kw": episode.p_ref_kw(s, drawn, after),
        "compute_share": episode.compute_share(s, drawn, after),
    }
    inputs = {name: stacked(name, preview.get(name)) for name in Exogenous._fields if name not in NOT_SERIES}
    return Outside(inputs, np.stack(noise_pu) if noise_pu else None), drawn.buses

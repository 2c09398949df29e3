"""An episode as arrays over time, and the recorder that collects it; ``metric_list`` names the metrics."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from dcgrid_env.engine.cost.fluctuation import WorstFlicker, worst_flicker
from dcgrid_env.engine.cost.grid_metrics import StreamingGrid, after_loss
from dcgrid_env.engine.exogenous.trace_pool import trace_pool
from dcgrid_env.engine.physics.state import device_field, over_arrays
from dcgrid_env.scenario.scenario import Scenario

if TYPE_CHECKING:
    from dcgrid_env.engine.simulation import Transition


class Series:
    """One episode as arrays over time: ``v_pu`` and ``backlog_kws`` from the reset on (T + 1 rows), the rest T rows."""

    def __init__(self, scenario: Scenario, transitions: list[Transition], env_index: int):
        self._take(
            scenario,
            _course(transitions, lambda values: np.array([step_values[env_index] for step_values in values])),
            env_index,
        )

    @classmethod
    def of_batch(cls, scenario: Scenario, transitions: list[Transition], lengths: Sequence[int]) -> list[Series | None]:
        """The first so many steps of each environment; None where there are none. They share memory."""
        stacked = _course(transitions, np.array)
        return [cls._cut(scenario, stacked, env_index, n) if n else None for env_index, n in enumerate(lengths)]

    @classmethod
    def _cut(cls, scenario: Scenario, stacked: _Course, env_index: int, steps: int) -> Series:
        series = cls.__new__(cls)
        from_reset = over_arrays(lambda values: values[: steps + 1, env_index], stacked.from_reset)
        of_steps = over_arrays(lambda values: values[:steps, env_index], stacked.of_steps)
        series._take(scenario, _Course(from_reset, of_steps, stacked.drawn), env_index)
        return series

    def _take(self, scenario: Scenario, course: _Course, env_index: int) -> None:
        self.scenario = scenario
        self.v_pu, self.p_kw_from_reset, self.devices, self.three_phase, self.loading, request = course.from_reset
        """``devices`` are the states of each device over time, and ``three_phase`` is ``State.three_phase``, None on a
        balanced feeder, from the reset on; so is ``loading``, ``State.loading``, None where no rating is known."""
        self.p_kw = self.p_kw_from_reset[1:]
        self.request = None if request is None else request[1:]
        """``State.request``, (T, n_column); None where a scenario has no requests of a utility."""
        self.q_kvar, self.loss_kw, self.cost_j, converged, costs = course.of_steps
        self.costs = costs._asdict()
        self.trace_start, self.buses, self.fault = (drawn[env_index] for drawn in course.drawn)
        """Where each site's trace window begins, (n_site,); position in ``bus_ids`` of each agent's bus, (n_agent,);
        what each fault strikes and when, ``Episode.fault``, (n_fault, 3)."""
        self.converged = bool(converged[-1])

    def __getattr__(self, name: str) -> np.ndarray:
        """A field of a device's state over time, (T, slot), from the reset on where it is an amount at an instant."""
        if name.startswith("_") or name in ("devices", "scenario"):  # asked for before there are any, by copy say
            raise AttributeError(name)
        over_time = device_field(self.devices, name)
        return over_time if any(name in device.levels for device in self.scenario.devices) else over_time[1:]

    def metrics(self) -> dict[str, float]:
        """Every metric of the episode."""
        s, grid = self.scenario, StreamingGrid(self.scenario)
        grid.add(self)
        figures = grid.figures()
        for device, history in zip(s.devices, self.devices, strict=True):
            requests = self.requests() if device.input == "workload" else None
            figures |= device.metrics(history, s.dt_s, requests)
        return {name: float(value) for name, value in figures.items()} | self.after_loss()

    def after_loss(self) -> dict[str, float]:
        """Return the highest voltage with devices disconnected, if they can disconnect."""
        figures = after_loss(self.scenario, self.devices, self.v_pu[1:, self.scenario.feeder.load_slice])
        return {name: float(value) for name, value in figures.items()}

    def worst_flicker(self, lamp: str = "120V-60Hz") -> WorstFlicker:
        """Largest Pst of the episode, and where and when it was, in the light of a lamp of ``flicker.LAMPS``.

        ValueError for steps of more than 0.1 s, or a scenario whose episodes are shorter than 600 s.
        """
        return worst_flicker(self.scenario, self.v_pu[1:], lamp)

    def requests(self) -> list[tuple[Any, float]] | None:
        """The requests of each site's row of trace and when the episode begins among them, s; None without any.

        Also None if a period of full load asks for work without requests.
        """
        pool = trace_pool(self.scenario)
        if not (pool.requests and len(self.trace_start)) or self.scenario.workload.full_load_s is not None:
            return None
        row, offset = np.divmod(self.trace_start, pool.p_share.shape[1])
        begin_s = (offset + 1) * self.scenario.dt_s
        return [(pool.requests[r], begin) for r, begin in zip(row, begin_s, strict=True)]


class _Course(NamedTuple):
    """Contents of a series, arrays with time as the first axis."""

    from_reset: tuple[Any, ...]
    """Voltages, draws, states of the devices and of three phases, loading, requests, from the reset on."""
    of_steps: tuple[Any, ...]
    """Reactive injections, losses, costs, whether the power flow had a solution, and the terms of the cost."""
    drawn: tuple[np.ndarray, ...]
    """Beginnings of the trace windows, buses of the agents, and faults, as a transition has them."""


def _course(transitions: list[Transition], stack: Callable[[Sequence[Any]], Any]) -> _Course:
    """Transitions as arrays; ``stack`` makes one of those of all instants."""

    def over_time(parts: list[Any]) -> Any:
        return over_arrays(lambda *values: stack(values), *parts)

    states = [t.state for t in transitions]
    from_reset = [(s.v_pu, s.p_kw, s.devices, s.three_phase, s.loading, s.request) for s in states]
    of_steps = [(t.state.q_kvar, t.loss_kw, t.cost_j, t.converged, t.costs) for t in transitions[1:]]
    initial = transitions[0]
    return _Course(over_time(from_reset), over_time(of_steps), (initial.trace_start, initial.buses, initial.fault))


class Recorder:
    """Collects the transitions of one episode in every environment of a batch, from the reset on.

    Parameters
    ----------
    scenario, initial
        The scenario, and the transition of the reset.
    seeds
        Seed of each row's first episode if feeders are random: its trajectory is then assigned to one feeder.
    """

    def __init__(self, scenario: Scenario, initial: Transition, seeds: Sequence[int] | None = None):
        self.scenario, self._seeds = scenario, seeds
        self._transitions = [initial]
        n_env = len(initial.terminated)
        self._length = np.zeros(n_env, dtype=np.int64)
        self._over = np.zeros(n_env, dtype=bool)

    def add(self, transition: Transition) -> None:
        """Add a step's transition; an environment whose episode has ended before is not counted further."""
        self._length += ~self._over
        self._over |= transition.terminated | transition.truncated
        self._transitions.append(transition)

    @property
    def over(self) -> bool:
        """Whether the episode has ended in every environment."""
        return bool(self._over.all())

    def series(self, env_index: int) -> Series:
        """Return the trajectory of one environment's episode; ValueError before its first step."""
        if self._length[env_index] == 0:
            raise ValueError("no step has been recorded yet")
        taken = self._transitions[: int(self._length[env_index]) + 1]
        on = self.scenario if self._seeds is None else self.scenario.member(self._seeds[env_index])
        return Series(on, taken, env_index)

    def costs(self) -> np.ndarray:
        """J of each environment's episode, (row,); ValueError before all have ended."""
        if not self.over:
            raise ValueError("costs of an episode that has not ended; step until every environment is over")
        charged = np.array([t.cost_j for t in self._transitions[1:]])
        within = np.arange(len(charged))[:, None] < self._length
        return (charged * within).sum(axis=0) / self.scenario.horizon

    def metrics(self) -> list[dict[str, float]]:
        """The figures of each environment's episode; ValueError before all have ended."""
        if not self.over:
            raise ValueError("metrics of an episode that has not ended; step until every environment is over")
        return [self.series(i).metrics() for i in range(len(self._over))]


class JoinedRecorder(Recorder):
    """Recorder that combines recordings made elsewhere.

    Parameters
    ----------
    scenario
        The scenario that the parts are members of.
    parts
        Recordings, each with its environments in its own order.
    """

    def __init__(self, scenario: Scenario, parts: Sequence[tuple[np.ndarray, Recorder]]):
        self.scenario, self._parts = scenario, list(parts)
        places = [
            (int(env_index), k, i)
            for k, (env_indices, _) in enumerate(parts)
            for i, env_index in enumerate(env_indices)
        ]
        self._place = {env_index: (k, i) for env_index, k, i in places}

    def add(self, transition: object) -> None:
        """Raise TypeError: the parts record their own steps."""
        raise TypeError("a joined recorder takes no steps; add them to its parts")

    @property
    def over(self) -> bool:
        """Whether the episode has ended in every environment."""
        return all(part.over for _, part in self._parts)

    def series(self, env_index: int) -> Series:
        """The trajectory of one environment's episode, on its feeder."""
        part, part_index = self._place[env_index]
        return self._parts[part][1].series(part_index)

    def costs(self) -> np.ndarray:
        """J of each environment's episode, (row,)."""
        whole = np.empty(len(self._place))
        for env_indices, part in self._parts:
            whole[env_indices] = part.costs()
        return whole

    def metrics(self) -> list[dict[str, float]]:
        """The figures of each environment's episode."""
        return [self.series(i).metrics() for i in range(len(self._place))]

"""The interface of controllers: given a scenario, they turn observations into actions, of one environment or many."""

from __future__ import annotations

from typing import Any, ClassVar, NamedTuple, Protocol, runtime_checkable

import numpy as np

from dcgrid_env import Scenario, action_layout, field_names
from dcgrid_env.baselines.equipment_agents import EquipmentAgents, at_rest


@runtime_checkable
class Controller(Protocol):
    """Anything with these two methods drives any of the environments."""

    def reset(self, env_info: Scenario) -> None:
        """Begin new episodes of a scenario (an environment's ``scenario``); raise ValueError if it cannot be driven."""
        ...

    def act(self, observations: Any) -> Any:
        """Actions for observations, in the same form.

        Either a mapping of agent to its observation, as from ``parallel_env``, or the agents' joined, (..., n), as from
        ``gymnasium.make`` and ``gymnasium.make_vec``.
        """
        ...


@runtime_checkable
class NeedsPlacement(Protocol):
    """A controller that must also be given the agents' buses, as one with a model of the feeder.

    Besides, a class attribute ``observe`` (``Scenario.observe``) says which scope of observation a controller needs;
    without one it takes the scenario's.
    """

    def place(self, buses: np.ndarray) -> None:
        """Positions in ``bus_ids`` of the agents' buses, (row, n_agent), given after ``reset`` and before ``act``."""
        ...


@runtime_checkable
class ReportsFigures(Protocol):
    """A controller that reports figures of its episodes, which results contain next to the metrics."""

    def episode_figures(self) -> list[dict[str, float]]:
        """Figures since ``reset``, one mapping an environment, of the same names for all."""
        ...


def with_figures(controller: Controller, metrics: list[dict[str, float]]) -> list[dict[str, float]]:
    """Metrics of episodes, one mapping each, with the figures that the controller reports."""
    if not isinstance(controller, ReportsFigures):
        return metrics
    return [measured | figures for measured, figures in zip(metrics, controller.episode_figures(), strict=True)]


class Local(NamedTuple):
    """Local observations in physical units; leading dimensions are those of the observations."""

    v_pu: np.ndarray
    """(..., n_agent), data centres first, see :class:`LocalController`."""
    p_kw: np.ndarray
    """Draw, an inverter's injection negative, (..., n_agent)."""
    q_kvar: np.ndarray
    """Reactive injection as dispatched, (..., n_agent)."""
    p_ref_next_kw: np.ndarray
    """(..., n_dc)"""
    backlog_kws: np.ndarray
    """(..., n_dc)"""
    r_pu_per_mw: np.ndarray
    """R_ii: drop of the own voltage for each MW drawn, p.u., (..., n_agent)."""
    x_pu_per_mvar: np.ndarray
    """X_ii: the same for each Mvar drawn, and so the rise for each injected, (..., n_agent)."""
    stored_kwh: np.ndarray
    """(..., n_storage)"""


_OF_ALL = ("v_deviation", "p", "q", "r", "x")
_OF_SITES = ("p_ref_next", "backlog")
_STORED = "stored"
_CLOCK, _Q, _P = "clock", "q", "p"


KNOWN_DEVICES = ("datacenter", "inverter")
"""Kinds of devices that controllers with a model, and policies, are made for, in the order of their agents."""


def require_known_devices(who: str, scenario: Scenario, further: tuple[str, ...] = ()) -> None:
    """ValueError, saying why, where a scenario has devices other than data centres first and inverters then.

    ``further`` are kinds that may follow behind these.
    """
    known = (*KNOWN_DEVICES, *further)
    kinds = [device.kind for device in scenario.devices if device.count]
    foreign = [repr(kind) for kind in kinds if kind not in known]
    words = ", ".join(("data centres", "inverters", *further))
    if foreign:
        raise ValueError(
            f"{who} is made for {' and '.join(words.rsplit(', ', 1))} alone; scenario {scenario.name!r} has devices of "
            f"kind {', '.join(foreign)}: use a controller that is made for these, or a law"
        )
    if kinds != [kind for kind in known if kind in kinds]:
        behind = "".join(f", then {kind}" for kind in further)
        raise ValueError(
            f"{who} takes data centres first and inverters behind them{behind}; scenario {scenario.name!r} has the "
            f"order {', '.join(kinds)}: make it with its devices in the other order"
        )


def require_draws_of_work(who: str, scenario: Scenario) -> None:
    """ValueError, naming the field, where sites draw something else than what their work takes."""
    for field in ("smoothing", "cooling"):
        if any(getattr(device, field, None) is not None for device in scenario.devices):
            raise ValueError(
                f"{who} plans draws that are those of the work served; scenario {scenario.name!r} has {field} at its "
                f"data centres: use a law, or leave datacenter_{field} out"
            )


class LocalController:
    """Base of controllers that work on physical units: subclasses write ``control``.

    It drives the clocks of data centres and the reactive power of every agent that gives any, whatever its device, and
    the draws of storages where a subclass writes ``draw``. Other channels, of devices that it does not know, stay at
    rest. Regulators and capacitor banks that are agents are driven beside it, see ``equipment_agents``. In
    :class:`Local` and in what ``control`` returns, data centres stand before all others, which follow in the scenario's
    order, without regulators and capacitor banks.
    """

    moves_taps: ClassVar[bool] = True
    """Whether regulators that are agents follow their banks' own control, or stay at rest."""

    scenario: Scenario
    """What is driven, its regulators and capacitor banks under their own control."""

    def reset(self, env_info: Scenario) -> None:
        """Begin new episodes of a scenario; ValueError for one that the controller cannot drive."""
        self._equipment = EquipmentAgents(env_info, self.moves_taps)
        self.scenario = env_info = self._equipment.others
        kinds = np.array([device.kind for device in env_info.devices for _ in range(device.count)])
        order = np.argsort(kinds != "datacenter", kind="stable")
        names = field_names(env_info)
        starts = np.cumsum([0, *(len(names[agent]) for agent in env_info.agents)])[:-1][order]
        first = names[env_info.agents[order[0]]]
        # The fields that all agents have stand at the same place in each, and so do those of the data centres.
        self._at = {
            name: starts[: None if name in _OF_ALL else env_info.datacenters.count] + first.index(name)
            for name in (*_OF_ALL, *_OF_SITES)
            if name in first
        }
        self._storages = np.flatnonzero(kinds[order] == "storage")
        """Positions of the storages among the agents in this order."""
        if len(self._storages):
            group = next(device for device in env_info.devices if device.kind == "storage")
            self._energy_kwh = group.parameters.energy_kwh
            self._at[_STORED] = starts[self._storages] + names["sto_0"].index(_STORED)
        devices = env_info.devices
        self._p_scale = np.concatenate([device.p_scale_kw for device in devices])[order]
        self._rated_kva = np.concatenate([device.converter_kva for device in devices])[order]
        self._q_scale = env_info.q_scale_kvar[order]
        self._lay_out([env_info.agents[i] for i in order])

    def _lay_out(self, agents: list[str]) -> None:
        """Find where the joint action has the clocks and the reactive setpoints of agents, and what it is at rest."""
        at = {entry: i for i, entry in enumerate(action_layout(self.scenario).names)}
        self._clock_at = [at[agent, _CLOCK] for agent in agents[: self.scenario.datacenters.count]]
        self._reactive = [i for i, agent in enumerate(agents) if (agent, _Q) in at]
        self._q_at = [at[agents[i], _Q] for i in self._reactive]
        self._p_at = [at[agents[i], _P] for i in self._storages]
        self._rest = at_rest(self.scenario)

    def control(self, local: Local) -> tuple[np.ndarray, np.ndarray]:
        """Clock of the data centres, MHz, (..., n_dc), and reactive setpoint of all agents, kvar, (..., n_agent)."""
        raise NotImplementedError

    def draw(self, local: Local) -> np.ndarray | None:
        """Draw of the storages, kW, negative to discharge, (..., n_storage); None leaves them at rest."""
        return None

    def act(self, observations: Any) -> Any:
        """See :class:`Controller`."""
        return self._equipment.act(observations, self._act)

    def _act(self, joint: np.ndarray) -> np.ndarray:
        """The joint action for a joint observation, both without regulators and capacitor banks."""
        local = self._local(joint)
        return self._joint(*self.control(local), self.draw(local))

    def _local(self, joint: np.ndarray) -> Local:
        rated = self.scenario.datacenters.parameters.p_rated_kw
        wide = joint.astype(np.float64)
        none = np.zeros((*wide.shape[:-1], 0))
        band = self.scenario.cost.band_pu or 1.0
        fields = {name: wide[..., columns] for name, columns in self._at.items()}
        return Local(
            v_pu=1.0 + band * fields["v_deviation"],
            p_kw=fields["p"] * self._p_scale,
            q_kvar=fields["q"] * self._q_scale,
            p_ref_next_kw=fields.get("p_ref_next", none) * rated,
            backlog_kws=fields.get("backlog", none) * rated,
            r_pu_per_mw=band * fields["r"],
            x_pu_per_mvar=band * fields["x"],
            stored_kwh=self._energy_kwh * fields[_STORED] if _STORED in fields else none,
        )

    def _joint(self, f_mhz: np.ndarray, q_kvar: np.ndarray, draw_kw: np.ndarray | None) -> np.ndarray:
        s = self.scenario
        span = s.datacenters.f_max_mhz - s.datacenters.f_min_mhz
        clock = 2.0 * (f_mhz - s.datacenters.f_min_mhz) / span - 1.0 if span else np.ones_like(f_mhz)
        q = q_kvar / np.where(self._q_scale > 0, self._q_scale, 1.0)
        actions = np.zeros((*q.shape[:-1], 1)) + self._rest
        actions[..., self._clock_at] = clock
        actions[..., self._q_at] = q[..., self._reactive]
        if draw_kw is not None:
            actions[..., self._p_at] = draw_kw / self._p_scale[self._storages]
        return np.clip(actions, -1.0, 1.0).astype(np.float32)

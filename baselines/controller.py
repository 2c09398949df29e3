"""Define the interface of controllers, which compute actions from observations of one environment or many."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar, NamedTuple, Protocol, runtime_checkable

import numpy as np

from dcgrid_env import RegulatorState, Scenario, action_layout, field_names
from dcgrid_env.baselines.equipment_agents import EquipmentAgents, at_rest


@runtime_checkable
class Controller(Protocol):
    """Interface of a controller: an object with these two methods can drive any of the environments."""

    def reset(self, env_info: Scenario) -> None:
        """Begin new episodes of a scenario (an environment's ``scenario``); raise ValueError if it cannot be driven."""
        ...

    def act(self, observations: Any) -> Any:
        """Return actions for observations, in the same form.

        Observations are either a mapping of agent to its observation, as from ``parallel_env``, or the concatenated
        observations of all agents, (..., n), as from ``gymnasium.make`` and ``gymnasium.make_vec``.
        """
        ...


@runtime_checkable
class NeedsPlacement(Protocol):
    """Interface of a controller that also needs the agents' buses, such as one with a model of the feeder.

    In addition, the class attribute ``observe`` (``Scenario.observe``) selects the scope of observation that a
    controller needs; the default is the scenario's.
    """

    def place(self, buses: np.ndarray) -> None:
        """Set the agents' buses, positions in ``bus_ids``, (row, n_agent); called between ``reset`` and ``act``."""
        ...


@runtime_checkable
class NeedsRegulators(Protocol):
    """Interface of a controller that also needs measurements of a three-phase feeder's regulators, as utilities have.

    They are ``env.transition.state.three_phase.equipment.regulators`` of an environment.
    """

    def measure(self, regulators: RegulatorState) -> None:
        """Receive taps, relay volts and timers of all regulators, each (row, n_regulator); called before ``act``."""
        ...


@runtime_checkable
class ReportsFigures(Protocol):
    """Interface of a controller that reports figures of its episodes, which results contain next to the metrics."""

    def episode_figures(self) -> list[dict[str, float]]:
        """Return the figures since ``reset``, one mapping for each environment, with the same names in all."""
        ...


def with_figures(controller: Controller, metrics: list[dict[str, float]]) -> list[dict[str, float]]:
    """Add the figures that a controller reports to the metrics of the episodes, one mapping each."""
    if not isinstance(controller, ReportsFigures):
        return metrics
    return [measured | figures for measured, figures in zip(metrics, controller.episode_figures(), strict=True)]


class Local(NamedTuple):
    """Local observations in physical units; leading dimensions are those of the observations."""

    v_pu: np.ndarray
    """Voltage at each agent's bus, p.u., (..., n_agent), data centres first, see :class:`LocalController`."""
    p_kw: np.ndarray
    """Active power drawn, kW, negative for the injection of an inverter, (..., n_agent)."""
    q_kvar: np.ndarray
    """Dispatched reactive injection, kvar, (..., n_agent)."""
    p_ref_next_kw: np.ndarray
    """Reference draw of the next interval, kW, (..., n_dc)."""
    backlog_kws: np.ndarray
    """Queued work, kW s, (..., n_dc)."""
    r_pu_per_mw: np.ndarray
    """R_ii: voltage drop at the agent's bus for each MW drawn, p.u., (..., n_agent)."""
    x_pu_per_mvar: np.ndarray
    """X_ii: voltage drop at the agent's bus for each Mvar drawn, or rise for each injected, p.u., (..., n_agent)."""
    stored_kwh: np.ndarray
    """Stored energy, kWh, (..., n_storage)."""


_OF_ALL = ("v_deviation", "p", "q", "r", "x")
_OF_SITES = ("p_ref_next", "backlog")
_STORED = "stored"
_CLOCK, _Q, _P = "clock", "q", "p"


KNOWN_DEVICES = ("datacenter", "inverter")
"""Kinds of devices that model-based controllers and policies support, in the order of their agents."""


def require_known_devices(who: str, scenario: Scenario, further: tuple[str, ...] = ()) -> None:
    """Raise ValueError unless a scenario's devices are data centres, then inverters, in this order.

    ``further`` are kinds that may follow these.
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


def require_work_draws(who: str, scenario: Scenario) -> None:
    """Raise ValueError, naming the field, if the draw of sites is not the power of the work served."""
    for field in ("smoothing", "cooling"):
        if any(getattr(device, field, None) is not None for device in scenario.devices):
            raise ValueError(
                f"{who} plans draws that are those of the work served; scenario {scenario.name!r} has {field} at its "
                f"data centres: use a law, or leave datacenter_{field} out"
            )


class LocalController:
    """Base class of controllers that work in physical units; subclasses implement ``control``.

    It sets the clocks of data centres and the reactive power of every agent that can supply it, whatever its device. It
    also sets the draws of storages if a subclass implements ``draw``. All other channels keep their initial value.
    ``equipment_agents`` drives regulators and capacitor banks that are agents. In :class:`Local` and in the result of
    ``control``, data centres come first. The other agents follow in the scenario's order, without regulators and
    capacitor banks.
    """

    moves_taps: ClassVar[bool] = True
    """Whether regulators that are agents follow the control of their banks, or keep their initial position."""

    scenario: Scenario
    """The scenario with regulators and capacitor banks under automatic control."""

    @property
    def set_points(self) -> Mapping[str, Mapping[str, Any]]:
        """Return constant set points for agents of regulators and capacitor banks, by channel and bank.

        Set points that are not named keep their default.
        """
        return {}

    def reset(self, env_info: Scenario) -> None:
        """Begin new episodes of a scenario; raise ValueError if the controller cannot drive it."""
        self._equipment = EquipmentAgents(env_info, self.moves_taps, set_points=self.set_points)
        self.scenario = env_info = self._equipment.others
        kinds = np.array([device.kind for device in env_info.devices for _ in range(device.count)])
        order = np.argsort(kinds != "datacenter", kind="stable")
        names = field_names(env_info)
        starts = np.cumsum([0, *(len(names[agent]) for agent in env_info.agents)])[:-1][order]
        first = names[env_info.agents[order[0]]]
        # The fields that all agents have are at the same position in each, and so are those of the data centres.
        self._columns = {
            name: starts[: None if name in _OF_ALL else env_info.datacenters.count] + first.index(name)
            for name in (*_OF_ALL, *_OF_SITES)
            if name in first
        }
        self._storages = np.flatnonzero(kinds[order] == "storage")
        """Positions of the storages among the agents in this order."""
        if len(self._storages):
            group = next(device for device in env_info.devices if device.kind == "storage")
            self._energy_kwh = group.parameters.energy_kwh
            self._columns[_STORED] = starts[self._storages] + names["sto_0"].index(_STORED)
        devices = env_info.devices
        self._p_scale = np.concatenate([device.p_scale_kw for device in devices])[order]
        self._rated_kva = np.concatenate([device.converter_kva for device in devices])[order]
        self._q_scale = env_info.q_scale_kvar[order]
        self._lay_out([env_info.agents[i] for i in order])

    def _lay_out(self, agents: list[str]) -> None:
        """Find the positions of clocks and reactive set points in the joint action, and its initial value."""
        position = {entry: i for i, entry in enumerate(action_layout(self.scenario).names)}
        self._clock_at = [position[agent, _CLOCK] for agent in agents[: self.scenario.datacenters.count]]
        self._reactive = [i for i, agent in enumerate(agents) if (agent, _Q) in position]
        self._q_at = [position[agents[i], _Q] for i in self._reactive]
        self._p_at = [position[agents[i], _P] for i in self._storages]
        self._rest = at_rest(self.scenario)

    def control(self, local: Local) -> tuple[np.ndarray, np.ndarray]:
        """Return the data centres' clocks, MHz, (..., n_dc), and all reactive set points, kvar, (..., n_agent)."""
        raise NotImplementedError

    def draw(self, local: Local) -> np.ndarray | None:
        """Return the draw of the storages, kW, negative to discharge, (..., n_storage); None leaves them inactive."""
        return None

    def act(self, observations: Any) -> Any:
        """Return actions for observations, see :class:`Controller`."""
        return self._equipment.act(observations, self._act)

    def _act(self, joint: np.ndarray) -> np.ndarray:
        """Return the joint action for a joint observation, both without regulators and capacitor banks."""
        local = self._local(joint)
        return self._joint(*self.control(local), self.draw(local))

    def _local(self, joint: np.ndarray) -> Local:
        rated = self.scenario.datacenters.parameters.p_rated_kw
        wide = joint.astype(np.float64)
        empty = np.zeros((*wide.shape[:-1], 0))
        band = self.scenario.cost.band_pu or 1.0
        fields = {name: wide[..., columns] for name, columns in self._columns.items()}
        return Local(
            v_pu=1.0 + band * fields["v_deviation"],
            p_kw=fields["p"] * self._p_scale,
            q_kvar=fields["q"] * self._q_scale,
            p_ref_next_kw=fields.get("p_ref_next", empty) * rated,
            backlog_kws=fields.get("backlog", empty) * rated,
            r_pu_per_mw=band * fields["r"],
            x_pu_per_mvar=band * fields["x"],
            stored_kwh=self._energy_kwh * fields[_STORED] if _STORED in fields else empty,
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

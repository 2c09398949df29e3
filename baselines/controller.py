"""The interface of controllers: given a scenario, they turn observations into actions, of one environment or many."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple, Protocol, runtime_checkable

import numpy as np

from dcgrid_env import Scenario, action_layout, field_names


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
class Placed(Protocol):
    """A controller that must also be given the agents' buses, as one with a model of the feeder.

    Besides, a class attribute ``observe`` (``Scenario.observe``) says which scope of observation a controller needs;
    without one it takes the scenario's.
    """

    def place(self, buses: np.ndarray) -> None:
        """Positions in ``bus_ids`` of the agents' buses, (lane, n_agent), given after ``reset`` and before ``act``."""
        ...


class Local(NamedTuple):
    """Local observations in physical units; leading dimensions are those of the observations."""

    v_pu: np.ndarray
    """(..., n_agent), data centres first."""
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


_OF_ALL = ("v_deviation", "p", "q", "r", "x")
_OF_SITES = ("p_ref_next", "backlog")


KNOWN_DEVICES = ("datacenter", "inverter")
"""Kinds of devices that the controllers and policies of this package are made for, in the order of their agents."""


def require_known_devices(who: str, scenario: Scenario) -> None:
    """ValueError, naming the devices, where a scenario has others than data centres first and inverters then."""
    kinds = [device.kind for device in scenario.devices if device.count]
    if kinds != [kind for kind in KNOWN_DEVICES if kind in kinds]:
        raise ValueError(
            f"{who} knows data centres, and inverters behind them; scenario {scenario.name!r} has {', '.join(kinds)}: "
            "use a controller that is made for these"
        )


class LocalController:
    """Base of controllers that work on physical units: subclasses write ``control``."""

    scenario: Scenario

    def reset(self, env_info: Scenario) -> None:
        """Begin new episodes of a scenario; ValueError for one with devices that the controller does not know."""
        require_known_devices(type(self).__name__, env_info)
        self.scenario = env_info
        names = field_names(env_info)
        starts = np.cumsum([0, *(len(names[agent]) for agent in env_info.agents)])[:-1]
        first = names[env_info.agents[0]]
        # The fields that all agents have stand at the same place in each; so do those of the data centres, which come
        # first if there are any.
        self._at = {
            name: starts[: None if name in _OF_ALL else env_info.n_datacenters] + first.index(name)
            for name in (*_OF_ALL, *_OF_SITES)
            if name in first
        }
        dc, inv = env_info.datacenter, env_info.inverter
        self._p_scale = np.concatenate((dc.p_rated_kw, inv.s_rated_kva))
        self._q_scale = env_info.q_scale_kvar

    def control(self, local: Local) -> tuple[np.ndarray, np.ndarray]:
        """Clock of the data centres, MHz, (..., n_dc), and reactive setpoint of all agents, kvar, (..., n_agent)."""
        raise NotImplementedError

    def act(self, observations: Any) -> Any:
        """See :class:`Controller`."""
        if isinstance(observations, Mapping):
            joint = np.concatenate([observations[agent] for agent in self.scenario.agents], axis=-1)
            actions = self._joint(*self.control(self._local(joint)))
            return action_layout(self.scenario).split(actions)
        return self._joint(*self.control(self._local(np.asarray(observations))))

    def _local(self, joint: np.ndarray) -> Local:
        rated = self.scenario.datacenter.p_rated_kw
        wide = joint.astype(np.float64)
        none = np.zeros((*wide.shape[:-1], 0))
        band = self.scenario.band_pu or 1.0
        fields = {name: wide[..., at] for name, at in self._at.items()}
        return Local(
            v_pu=1.0 + band * fields["v_deviation"],
            p_kw=fields["p"] * self._p_scale,
            q_kvar=fields["q"] * self._q_scale,
            p_ref_next_kw=fields.get("p_ref_next", none) * rated,
            backlog_kws=fields.get("backlog", none) * rated,
            r_pu_per_mw=band * fields["r"],
            x_pu_per_mvar=band * fields["x"],
        )

    def _joint(self, f_mhz: np.ndarray, q_kvar: np.ndarray) -> np.ndarray:
        s = self.scenario
        span = s.f_max_mhz - s.f_min_mhz
        clock = 2.0 * (f_mhz - s.f_min_mhz) / span - 1.0 if span else np.ones_like(f_mhz)
        q = q_kvar / np.where(self._q_scale > 0, self._q_scale, 1.0)
        actions = action_layout(s).joint(clock=clock, q=q)
        return np.clip(actions, -1.0, 1.0).astype(np.float32)

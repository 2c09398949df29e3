"""The interface of controllers: given a scenario, they turn observations into actions, of one environment or many."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar, NamedTuple, Protocol, runtime_checkable

import numpy as np

from dcgrid_env import BankControl, Scenario, acting_relays, action_layout, field_names


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


_OF_ALL = ("v_deviation", "p", "q", "r", "x")
_OF_SITES = ("p_ref_next", "backlog")
_CLOCK, _Q, _TAP = "clock", "q", "tap"


KNOWN_DEVICES = ("datacenter", "inverter")
"""Kinds of devices that controllers with a model, and policies, are made for, in the order of their agents."""


def require_known_devices(who: str, scenario: Scenario) -> None:
    """ValueError, saying why, where a scenario has devices other than data centres first and inverters then."""
    kinds = [device.kind for device in scenario.devices if device.count]
    foreign = [repr(kind) for kind in kinds if kind not in KNOWN_DEVICES]
    if foreign:
        raise ValueError(
            f"{who} is made for data centres and inverters alone; scenario {scenario.name!r} has devices of kind "
            f"{', '.join(foreign)}: use a controller that is made for these, or a law"
        )
    if kinds != [kind for kind in KNOWN_DEVICES if kind in kinds]:
        raise ValueError(
            f"{who} takes data centres first and inverters behind them; scenario {scenario.name!r} has the order "
            f"{', '.join(kinds)}: make it with its devices in the other order"
        )


class LocalController:
    """Base of controllers that work on physical units: subclasses write ``control``.

    It drives the clocks of data centres and the reactive power of every agent that gives any, whatever its device.
    Regulators that are agents follow what the control of their own bank would do. Other channels, of devices that it
    does not know, stay at rest, as those of capacitor banks do. In :class:`Local` and in what ``control`` returns, data
    centres stand before all others, which follow in the scenario's order.
    """

    moves_taps: ClassVar[bool] = True
    """Whether regulators are driven, or stay at rest too."""

    scenario: Scenario

    def reset(self, env_info: Scenario) -> None:
        """Begin new episodes of a scenario; ValueError for one that the controller cannot drive."""
        self.scenario = env_info
        kinds = np.array([device.kind for device in env_info.devices for _ in range(device.count)])
        order = np.argsort(kinds != "datacenter", kind="stable")
        names = field_names(env_info)
        starts = np.cumsum([0, *(len(names[agent]) for agent in env_info.agents)])[:-1][order]
        first = names[env_info.agents[order[0]]]
        # The fields that all agents have stand at the same place in each, and so do those of the data centres.
        self._at = {
            name: starts[: None if name in _OF_ALL else env_info.n_datacenters] + first.index(name)
            for name in (*_OF_ALL, *_OF_SITES)
            if name in first
        }
        devices = env_info.devices
        self._p_scale = np.concatenate([device.p_scale_kw for device in devices])[order]
        self._rated_kva = np.concatenate([device.converter_kva for device in devices])[order]
        self._q_scale = env_info.q_scale_kvar[order]
        self._lay_out([env_info.agents[i] for i in order])
        self._regulators = _Regulators(env_info) if self.moves_taps and "tap_changer" in kinds else None

    def _lay_out(self, agents: list[str]) -> None:
        """Find where the joint action has the clocks and the reactive setpoints of agents, and what it is at rest."""
        at = {entry: i for i, entry in enumerate(action_layout(self.scenario).names)}
        self._clock_at = [at[agent, _CLOCK] for agent in agents[: self.scenario.n_datacenters]]
        self._reactive = [i for i, agent in enumerate(agents) if (agent, _Q) in at]
        self._q_at = [at[agents[i], _Q] for i in self._reactive]
        rest = [
            np.stack([_at_rest(channel) for channel in device.channels], axis=-1).ravel()
            for device in self.scenario.devices
            if device.count and device.channels
        ]
        self._rest = np.concatenate([np.empty(0), *rest])

    def control(self, local: Local) -> tuple[np.ndarray, np.ndarray]:
        """Clock of the data centres, MHz, (..., n_dc), and reactive setpoint of all agents, kvar, (..., n_agent)."""
        raise NotImplementedError

    def act(self, observations: Any) -> Any:
        """See :class:`Controller`."""
        if isinstance(observations, Mapping):
            joint = np.concatenate([observations[agent] for agent in self.scenario.agents], axis=-1)
            return action_layout(self.scenario).split(self._actions(joint))
        return self._actions(np.asarray(observations))

    def _actions(self, joint: np.ndarray) -> np.ndarray:
        actions = self._joint(*self.control(self._local(joint)))
        if self._regulators is not None:
            actions[..., self._regulators.action_at] = self._regulators.actions(joint)
        return actions

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
        actions = np.zeros((*q.shape[:-1], 1)) + self._rest
        actions[..., self._clock_at] = clock
        actions[..., self._q_at] = q[..., self._reactive]
        return np.clip(actions, -1.0, 1.0).astype(np.float32)


class _Regulators:
    """The regulators that are agents of a scenario, driven as their banks' own control would from what they observe."""

    def __init__(self, scenario: Scenario) -> None:
        relays = acting_relays(scenario, "agent")
        assert relays is not None
        (self._channel,) = next(device for device in scenario.devices if device.kind == "tap_changer").channels
        self._control, self._band = BankControl(relays, scenario.dt_s), scenario.band_pu or 1.0
        self._farthest = np.maximum(np.maximum(np.abs(self._channel.lowest), np.abs(self._channel.highest)), 1.0)
        names = [name for own in field_names(scenario).values() for name in own]
        self._tap_at, self._relay_at = ([i for i, name in enumerate(names) if name == own] for own in ("tap", "relay"))
        self.action_at = np.flatnonzero(action_layout(scenario).is_channel(_TAP))

    def actions(self, joint: np.ndarray) -> np.ndarray:
        """Entries of the action, (..., n), from the joint observation."""
        tap = np.rint(joint[..., self._tap_at] * self._farthest)
        relay_v = self._control.target_v * (1.0 + self._band * joint[..., self._relay_at])
        asked = self._control.taps(*(values.reshape(-1, tap.shape[-1]) for values in (tap, relay_v)))
        low, high = self._channel.lowest, self._channel.highest
        shares = 2.0 * (asked - low) / np.where(high > low, high - low, 1.0) - 1.0
        return shares.reshape(tap.shape)


def _at_rest(channel: Any) -> np.ndarray:
    """The entry of the action that leaves a channel where it is at t = 0, (slot,); 0 where it has no range."""
    span = channel.highest - channel.lowest
    return np.where(span > 0, 2.0 * (channel.rest - channel.lowest) / np.where(span > 0, span, 1.0) - 1.0, 0.0)

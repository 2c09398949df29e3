"""Drive regulators and capacitor banks that are agents, in addition to a controller for the other agents."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from dcgrid_env import BankControl, Scenario, acting_relays, action_layout, field_names, under_own_control
from dcgrid_env.devices import Channel

_TAP = "tap"
_SAME = 1e-6  # in the unit of a set point, by which it may exceed its range


class EquipmentAgents:
    """Feeder equipment among a scenario's agents, if any.

    Regulators follow the automatic control of their bank about a step later: they observe the relay at the end of a
    step and predict its volts within the next. Capacitor banks keep their state, and set points are constant. The
    object stores the timers of the relays, so each run of episodes needs a new one.

    Parameters
    ----------
    scenario
        Scenario to drive.
    moves_taps
        Whether regulators are driven; if not, they also keep their position of t = 0.
    keep_set_points
        Whether agents of set points are among the other agents.
    set_points
        Set points by channel and bank: numbers, or arrays with a value for each environment (row,). Others keep the
        default.
    """

    def __init__(
        self,
        scenario: Scenario,
        moves_taps: bool = True,
        keep_set_points: bool = False,
        set_points: Mapping[str, Mapping[str, Any]] | None = None,
    ) -> None:
        self.scenario, self.others = scenario, under_own_control(scenario, keep_set_points)
        """``others`` is the scenario that a controller of the other agents receives."""
        among = set(self.others.agents)
        self.is_other = np.array([agent in among for agent in scenario.agents])
        """Mask of the agents other than equipment, bool, (n_agent,)."""
        names, self._layout = field_names(scenario), action_layout(scenario)
        is_observed = np.array([agent in among for agent in scenario.agents for _ in names[agent]])
        self._observed = None if is_observed.all() else np.flatnonzero(is_observed)
        self._others_at = np.array([agent in among for agent, _ in self._layout.names])
        self._rest = _with_set_points(scenario, set_points or {})
        driven = moves_taps and any(device.kind == "tap_changer" for device in scenario.devices)
        self._regulators = _Regulators(scenario) if driven else None

    def act(self, observations: Any, of_others: Callable[[np.ndarray], np.ndarray]) -> Any:
        """Return the actions of all agents in the form of the observations: a mapping of agents, or joint, (..., n).

        ``of_others`` returns the joint action of the others, (..., n_action), for their joint observation.
        """
        if isinstance(observations, Mapping):
            joint = np.concatenate([observations[agent] for agent in self.scenario.agents], axis=-1)
            return self._layout.split(self._joint(joint, of_others))
        return self._joint(np.asarray(observations), of_others)

    def _joint(self, joint: np.ndarray, of_others: Callable[[np.ndarray], np.ndarray]) -> np.ndarray:
        if self._observed is None:
            return of_others(joint)
        of_policy = of_others(joint[..., self._observed])
        actions = np.empty((*of_policy.shape[:-1], self._rest.shape[-1]), of_policy.dtype)
        actions[...] = self._rest
        actions[..., self._others_at] = of_policy
        if self._regulators is not None:
            actions[..., self._regulators.action_at] = self._regulators.actions(joint)
        return actions


class _Regulators:
    """The regulators among the agents, driven by the automatic control of their banks from their observations."""

    def __init__(self, scenario: Scenario) -> None:
        relays = acting_relays(scenario, "agent")
        assert relays is not None
        integrating = scenario.grid_control.regulator_settings.timer == "integrating"
        (self._channel,) = next(device for device in scenario.devices if device.kind == "tap_changer").channels
        self._control, self._band = BankControl(relays, scenario.dt_s, integrating), scenario.cost.band_pu or 1.0
        self._farthest = np.maximum(np.maximum(np.abs(self._channel.lowest), np.abs(self._channel.highest)), 1.0)
        names = [name for agent_names in field_names(scenario).values() for name in agent_names]
        self._tap_at, self._relay_at = (
            [i for i, name in enumerate(names) if name == wanted] for wanted in (_TAP, "relay")
        )
        self.action_at = np.flatnonzero(action_layout(scenario).is_channel(_TAP))

    def actions(self, joint: np.ndarray) -> np.ndarray:
        """Return the regulators' entries of the action, (..., n), from the joint observation."""
        tap = np.rint(joint[..., self._tap_at] * self._farthest)
        relay_v = self._control.target_v * (1.0 + self._band * joint[..., self._relay_at])
        taps = self._control.taps(*(values.reshape(-1, tap.shape[-1]) for values in (tap, relay_v)))
        low, high = self._channel.lowest, self._channel.highest
        shares = 2.0 * (taps - low) / np.where(high > low, high - low, 1.0) - 1.0
        return shares.reshape(tap.shape)


def at_rest(scenario: Scenario) -> np.ndarray:
    """Return the joint action that keeps every channel at its value of t = 0, (n_action,); 0 without a range."""
    entries = [
        np.stack([action_of(channel, channel.rest) for channel in device.channels], axis=-1).ravel()
        for device in scenario.devices
        if device.count and device.channels
    ]
    return np.concatenate([np.empty(0), *entries])


def _with_set_points(scenario: Scenario, set_points: Mapping[str, Mapping[str, Any]]) -> np.ndarray:
    """Return the joint action ``at_rest`` with constant set points, (n_action,), or (row, n_action) for arrays."""
    position, rest = {entry: i for i, entry in enumerate(action_layout(scenario).names)}, at_rest(scenario)
    devices: tuple[Any, ...] = scenario.devices
    chosen = [
        (position[f"{device.prefix}_{slot}", channel.name], channel.lowest[slot], channel.highest[slot], of_banks[bank])
        for device in devices
        for channel in device.channels
        if (of_banks := set_points.get(channel.name))
        for slot, bank in enumerate(device.names)
        if bank in of_banks
    ]
    rows = np.broadcast_shapes(*(np.shape(value) for *_, value in chosen))
    actions = np.zeros((*rows, len(rest))) + rest
    for entry, lowest, highest, value in chosen:
        if np.min(value) < lowest - _SAME or np.max(value) > highest + _SAME:
            agent, channel = action_layout(scenario).names[entry]
            limits = f"{lowest:g} to {highest:g}"
            raise ValueError(f"set point of {agent}: {channel} is {value}; give a number from {limits}")
        actions[..., entry] = 2.0 * (value - lowest) / (highest - lowest) - 1.0
    return actions


def action_of(channel: Channel, values: np.ndarray) -> np.ndarray:
    """Return the action for values of a channel, (..., slot), from -1 to 1 over its range; 0 without a range."""
    span = channel.highest - channel.lowest
    return np.where(span > 0, 2.0 * (values - channel.lowest) / np.where(span > 0, span, 1.0) - 1.0, 0.0)

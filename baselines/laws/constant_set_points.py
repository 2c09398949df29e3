"""Laws with constant set points of regulators and capacitor banks, and the set points that a scenario leaves open.

    offset_v     offset of a bank's target, V on the relay's base of 120 V
    half_band_v  half the band of a bank's relays, V
    centre_pu    centre between the two thresholds of a capacitor bank, p.u.

Banks in mode ``"setpoint"`` are agents: a law sends them its set points. The offsets of regulators in mode
``"controlled"`` are a field of the scenario, ``grid_control.regulator_settings``. A law cannot change it, but
``dcgrid tune`` searches these offsets together with the law's other parameters. The tuned law then requires a scenario
with the same offsets.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields
from typing import Any, ClassVar, NamedTuple

import numpy as np

from dcgrid_env import Scenario, acting_relays
from dcgrid_env.baselines.controller import Local
from dcgrid_env.baselines.laws.static import ConstantQ
from dcgrid_env.baselines.parameter_checks import require_non_negative

CHANNELS: dict[str, str] = {"offset_v": "offset", "half_band_v": "half_band", "centre_pu": "centre"}
"""Channel of an agent, by the parameter of the law."""
SETTINGS = "grid_control.regulator_settings"
"""Field of the scenario with the offsets of controlled regulators."""
FARTHEST_V = 6.0
"""Largest offset of a controlled regulator that is searched, V."""
_REGULATORS, _CAPACITORS = "regulator_setpoint", "capacitor_setpoint"
_SAME = 1e-6


class SetPoint(NamedTuple):
    """A set point that a scenario leaves open."""

    parameter: str
    """One of ``CHANNELS``."""
    name: str
    """Bank that is an agent, or controlled regulator."""
    lowest: float
    highest: float
    default: float
    """Its value in the scenario."""
    by_agent: bool
    """Whether an agent chooses it; otherwise it is a field of the scenario."""


def open_set_points(scenario: Scenario) -> list[SetPoint]:
    """Return the set points that a scenario leaves open; empty if there are none.

    The offsets of controlled regulators are open if none follows a schedule.
    """
    groups: list[Any] = [device for device in scenario.devices if device.kind in (_REGULATORS, _CAPACITORS)]
    points = []
    for parameter, channel_name in CHANNELS.items():
        for group in groups:
            for channel in group.channels:
                if channel.name == channel_name:
                    limits = zip(group.names, channel.lowest, channel.highest, channel.rest, strict=True)
                    points += [
                        SetPoint(parameter, bank, *map(float, values), by_agent=True) for bank, *values in limits
                    ]
    settings, relays = scenario.grid_control.regulator_settings, acting_relays(scenario)
    if relays is None or settings.has_schedules:
        return points
    of_agents = {bank for group in groups if group.kind == _REGULATORS for bank in group.names}
    feeder: Any = scenario.feeder
    offsets = list(_offsets_v(scenario).items())
    for row in relays.rows.tolist():
        if feeder.network.regulator.bank[row] not in of_agents:
            name, volts = offsets[row]
            points.append(SetPoint("offset_v", name, -FARTHEST_V, FARTHEST_V, volts, by_agent=False))
    return points


def has_set_points(scenario: Scenario) -> bool:
    """Return whether a scenario leaves any set point open."""
    return bool(open_set_points(scenario))


def agents_choose_set_points(scenario: Scenario) -> bool:
    """Return whether agents choose any set point of a scenario."""
    return any(point.by_agent for point in open_set_points(scenario))


def offset_overrides(scenario: Scenario, offset_v: Mapping[str, float]) -> dict[str, Any]:
    """Return the override of a scenario with these offsets of its controlled regulators; empty without such ones.

    It is the argument of ``Scenario.replace``, as plain data.
    """
    controlled = [point.name for point in open_set_points(scenario) if not point.by_agent]
    chosen = {name: offset_v[name] for name in controlled if name in offset_v}
    if not chosen:
        return {}
    settings = scenario.grid_control.regulator_settings
    changed = {f.name: value for f in fields(settings) if (value := getattr(settings, f.name)) != f.default}
    return {SETTINGS: changed | {"offset_v": _offsets_v(scenario) | chosen}}


def _offsets_v(scenario: Scenario) -> dict[str, float]:
    """Return the constant offset of each regulator of a three-phase feeder in the scenario, V."""
    feeder: Any = scenario.feeder
    table = feeder.network.regulator
    return dict(zip(table.name, scenario.grid_control.regulator_settings.offsets_v(table).tolist(), strict=True))


@dataclass
class ConstantSetPoints(ConstantQ):
    """Constant set points and constant reactive power; set points that are not named keep the scenario's value.

    Parameters
    ----------
    q_share
        Share of the reactive limit, -1 to 1, injection positive: one number, or one for each agent, data centres first.
    offset_v
        Offset of the target by bank, V. For controlled regulators, that of the scenario by regulator.
    half_band_v
        Half the band by bank, V.
    centre_pu
        Centre between the thresholds by capacitor bank, p.u.
    """

    name: ClassVar[str] = "static"

    q_share: float | tuple[float, ...] = 0.0
    offset_v: Mapping[str, float] = field(default_factory=dict)
    half_band_v: Mapping[str, float] = field(default_factory=dict)
    centre_pu: Mapping[str, float] = field(default_factory=dict)

    def reset(self, env_info: Scenario) -> None:
        """Begin new episodes; ValueError if the scenario does not have these set points open."""
        self._require(env_info, open_set_points(env_info))
        super().reset(env_info)

    @property
    def set_points(self) -> dict[str, Mapping[str, float]]:
        """Set points by channel and bank."""
        return {channel: getattr(self, parameter) for parameter, channel in CHANNELS.items()}

    def _require(self, scenario: Scenario, points: Sequence[SetPoint]) -> None:
        if not points:
            remedy = "set grid_control.regulators to 'controlled' or 'setpoint', or capacitors to 'setpoint'"
            if scenario.grid_control.regulator_settings.has_schedules:
                remedy = f"give numbers for the schedules in {SETTINGS}.offset_v"
            raise ValueError(f"{self.name}: scenario {scenario.name!r} has no set points to choose; {remedy}")
        known = {(point.parameter, point.name): point for point in points}
        for parameter in CHANNELS:
            for name, value in getattr(self, parameter).items():
                if (parameter, name) not in known:
                    names = ", ".join(bank for other, bank in known if other == parameter) or "none"
                    raise ValueError(
                        f"{self.name}: {parameter} has {name!r}, which scenario {scenario.name!r} does not leave open; "
                        f"choose from {names}"
                    )
                self._require_value(scenario, known[parameter, name], value)

    def _require_value(self, scenario: Scenario, point: SetPoint, value: float) -> None:
        """Raise ValueError for a value out of range, or an offset that the scenario does not have."""
        low, high = np.min(value), np.max(value)  # of one controller, or one for each environment
        if not (low >= point.lowest - _SAME and high <= point.highest + _SAME):
            raise ValueError(
                f"{self.name}: {point.parameter} of {point.name!r} is {value}; give a number from {point.lowest:g} to "
                f"{point.highest:g}"
            )
        if not point.by_agent and max(abs(low - point.default), abs(high - point.default)) > _SAME:
            settings = json.dumps(offset_overrides(scenario, self.offset_v)[SETTINGS])
            raise ValueError(
                f"{self.name}: offset_v of {point.name!r} is {value}, but scenario {scenario.name!r} has "
                f"{point.default:g} V; add --set '{SETTINGS}={settings}'"
            )


@dataclass
class TwoTimescale(ConstantSetPoints):
    """Constant set points, around which reactive power follows the local voltage.

    Parameters
    ----------
    q_share, offset_v, half_band_v, centre_pu
        See :class:`ConstantSetPoints`. The reactive power at 1 p.u. is ``q_share``.
    slope_per_pu
        Change of reactive power for 1 p.u. of voltage once it has settled, as a share of the reactive limit.
    response_s
        Time constant with which reactive power settles, s.

    Notes
    -----
    The law is a droop with a time constant, or a leaky integral of the voltage::

        q_{t+1} = clip(q_t + min(dt / response_s, 1) (target_t - q_t), limits)
        target_t = (q_share - slope_per_pu (V_t - 1)) q_limit

    The set points are the slow channel: they decide where the relays hold the voltage. Reactive power is the fast
    channel: it compensates deviations within the band of the relays, so they tap less often.
    """

    name: ClassVar[str] = "two-timescale"

    slope_per_pu: float = 10.0
    response_s: float = 300.0

    def __post_init__(self) -> None:
        super().__post_init__()
        require_non_negative(self.name, slope_per_pu=self.slope_per_pu, response_s=self.response_s)

    def control(self, local: Local) -> tuple[np.ndarray, np.ndarray]:
        """See :class:`LocalController`."""
        f_mhz, rest_kvar = super().control(local)
        target_kvar = rest_kvar - self.slope_per_pu * (local.v_pu - 1.0) * self._q_scale
        pace = self.scenario.dt_s / np.maximum(self.response_s, self.scenario.dt_s)
        q_kvar = local.q_kvar + pace * (target_kvar - local.q_kvar)
        return f_mhz, np.clip(q_kvar, -self._q_scale, self._q_scale)

"""Connect a policy's networks to a scenario: compute network inputs, and actions from network outputs.

The array code runs with NumPy and torch, so a policy acts in use exactly as in training. Outputs are set points (the
action itself), changes from the action that keeps the current state, or corrections of a droop law with cumulative
memory (residual learning: T. Johannink et al., "Residual reinforcement learning for robot control", arXiv 1812.03201):

            change                                            droop                    constant
    clock   clock that just serves all arriving and queued    the law's, plus output   as for change
            work, less max(output, 0)
    q       current dispatch, plus output                     the law's, plus output   the agent's share, plus output
    other   rest value, plus output                           the same                 the same

Changes have two advantages. A network can represent an integrating law, such as the droop, without copying its reactive
power to four digits. The clock starts where slowing it down has an effect. Constant shares are for feeders on which a
constant is nearly right but not the same for all agents, for example on different phases. Other channels
are further device outputs, such as the power of a storage, with rest value 0, or the reconnection of a site with a UPS.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from dcgrid_env import Scenario, action_layout, field_names
from dcgrid_env.agents.policy.agent_groups import PLAIN_CHANNELS, agent_groups, axes
from dcgrid_env.agents.policy.neural_network import PolicyError
from dcgrid_env.baselines.equipment_agents import at_rest
from dcgrid_env.core.arrays import Array, namespace

KINDS = ("joint", "shared")
"""Kinds of policies: one network for all agents, or one for each kind of agent, named after the device kind."""
SCOPES = ("local", "neighbours", "feeder")
ACTS = ("both", "clock", "q")
OUTPUTS = ("setpoint", "change", "droop", "constant")
PLATES = ("draw", "reach", "needed")
"""Names of the nameplate inputs, see :class:`Policy`."""
SMALLEST_REACH, MOST_NEEDED = 1e-3, 3.0
"""Limits of the nameplate inputs: minimum effect of reactive power, bands, and maximum share needed."""


class Gains(NamedTuple):
    """Gains of the droop law that the outputs correct; see ``baselines.Droop``."""

    k_p_mw_per_pu: float
    k_q_mvar_per_pu_s: float
    alpha_per_s: float

    @classmethod
    def of(cls, values: Sequence[float]) -> Gains:
        """Create gains from values in this order; raise PolicyError for a wrong number or an invalid value."""
        figures = [float(value) for value in values]
        if len(figures) != len(cls._fields) or not all(0.0 <= value < float("inf") for value in figures):
            raise PolicyError(f"gains are {values!r}; give {', '.join(cls._fields)}, each at least 0")
        return cls(*figures)


def cut(x: Array, low: float, high: float) -> Array:
    """Limit ``x`` elementwise."""
    return x.clip(low, high)


class PolicyInterface:
    """Compute network inputs from observations, and actions from network outputs.

    Parameters
    ----------
    scenario
        Scenario to control.
    kind
        ``joint`` or ``shared``, see ``KINDS``.
    preview, act, nameplate, outputs, gains
        Settings of the policy, see :class:`Policy`.
    q_share
        Constant share of the reactive limit of each agent in ``q_agents``, (..., n_q), for ``outputs="constant"``.
    array
        Function that converts NumPy arrays: ``np.asarray``, or a conversion to tensors.
    clip
        Function that limits values to a range: ``cut``, or one with another derivative.
    """

    def __init__(
        self,
        scenario: Scenario,
        kind: str,
        *,
        preview: bool = True,
        act: str = "both",
        nameplate: bool = False,
        outputs: str = "setpoint",
        gains: Gains | None = None,
        q_share: Array | None = None,
        array: Callable[[np.ndarray], Any] = np.asarray,
        clip: Callable[[Any, float, float], Any] = cut,
    ):
        names = [field_names(scenario)[agent] for agent in scenario.agents]
        self.scenario, self.kind, self.nameplate, self.outputs = scenario, kind, nameplate, outputs
        self._clip, self.q_share = clip, q_share
        self.groups = agent_groups(scenario)
        """Agents of each kind."""
        self._n_observed = sum(map(len, names))
        joined = tuple(name for group_names in names for name in group_names)
        # What a policy without preview is not given.
        fields = (field for device in scenario.devices for field in device.fields(scenario.horizon, scenario.dt_s))
        hidden = {field.name for field in fields if field.of_preview}
        visible = np.array([preview or name not in hidden for name in joined])
        self._visible = None if visible.all() else array(visible.astype(np.float32))
        self._starts = np.cumsum([0, *map(len, names)])[:-1]
        p_scale_kw, q_scale_kvar = np.concatenate([d.p_scale_kw for d in scenario.devices]), scenario.q_scale_kvar
        self._scales_mw = [array((scale / 1e3).astype(np.float32)) for scale in (p_scale_kw, q_scale_kvar)]
        self._reactive = None if (q_scale_kvar > 0).all() else array(q_scale_kvar > 0)
        self._of_all = {z: self._columns(z, range(len(names)), array) for z in ("v_deviation", "r", "x")}
        self._lay_out(act, array)
        self._idle, self._dt_s = scenario.datacenters.idle_share, float(scenario.dt_s)
        self._slowest = scenario.datacenters.f_min_mhz / scenario.datacenters.f_max_mhz
        self._ahead = preview and scenario.sensing.preview
        if gains is not None:
            band = scenario.cost.band_pu or 1.0
            q_kvar = q_scale_kvar[self.q_agents]
            reach_mw = np.where(q_kvar > 0, q_kvar, np.inf) / 1e3
            self._k_q = array((gains.k_q_mvar_per_pu_s * self._dt_s * band / reach_mw).astype(np.float32))
            rated_kw = p_scale_kw[self._clock_agents]
            self._k_p = array((gains.k_p_mw_per_pu * band * 1e3 / rated_kw).astype(np.float32))
            self._alpha_per_s = gains.alpha_per_s

    def _lay_out(self, act: str, array: Callable[[np.ndarray], Any]) -> None:
        """Find the positions of clocks, reactive set points and other channels in the joint action and their inputs."""
        agents = {agent: i for i, agent in enumerate(self.scenario.agents)}
        owner = np.array([agents[agent] for agent, _ in action_layout(self.scenario).names], dtype=np.int64)
        self.is_clock, self.is_q = axes(self.scenario)
        self._n_action = len(owner)
        other = ~(self.is_clock | self.is_q)
        entries = [np.flatnonzero(chosen) for chosen in (self.is_clock, self.is_q, other)]
        self._clock_at, self._q_at, self._other_at = map(array, entries)
        self._back = array(np.argsort(np.concatenate(entries)))
        self._clock_agents, self.q_agents = owner[self.is_clock], owner[self.is_q]
        """``q_agents`` are the positions of the agents with a reactive output, (n_q,)."""
        rest = at_rest(self.scenario).astype(np.float32)
        self._rest, self._other_rest = array(rest), array(rest[other]) if other.any() else None
        held = {"both": np.zeros(len(owner), bool), "q": ~self.is_q, "clock": ~self.is_clock}[act]
        self._at_rest = array(held) if held.any() else None
        self._of_q = {name: self._columns(name, self.q_agents, array) for name in ("q", "v_deviation")}
        of_clock = ("p_ref_next", "backlog", "v_deviation")
        self._of_clock = {name: self._columns(name, self._clock_agents, array) for name in of_clock}

    def _columns(self, field: str, agents: Iterable[int], array: Callable[[np.ndarray], Any]) -> Array:
        """Return the positions of a field of these agents in the joint observation, (n,)."""
        names = field_names(self.scenario)
        positions = [self._starts[i] + names[self.scenario.agents[i]].index(field) for i in agents]
        return array(np.array(positions, dtype=np.int64))

    @property
    def widths(self) -> dict[str, tuple[int, int]]:
        """Number of inputs and outputs of each required network."""
        more = 3 * self.nameplate
        if self.kind == "joint":
            return {"joint": (self._n_observed + more * self.scenario.n_agents, self._n_action)}
        return {kind: (len(group.fields) + more, len(group.channels)) for kind, group in self.groups.items()}

    @property
    def input_fields(self) -> dict[str, tuple[str, ...]]:
        """Names of each network's inputs, in order; in a joint network with the agent's name and a dot as prefix."""
        plates = PLATES if self.nameplate else ()
        if self.kind == "shared":
            return {kind: (*group.fields, *plates) for kind, group in self.groups.items()}
        seen, agents = field_names(self.scenario), self.scenario.agents
        joint_names = [f"{agent}.{name}" for agent in agents for name in seen[agent]]
        return {"joint": (*joint_names, *(f"{agent}.{plate}" for plate in plates for agent in agents))}

    @property
    def channels(self) -> dict[str, tuple[str, ...]]:
        """Names of each network's outputs, in order."""
        if self.kind == "joint":
            return {"joint": tuple(channel for _, channel in action_layout(self.scenario).names)}
        return {kind: group.channels for kind, group in self.groups.items()}

    @property
    def plain_channels(self) -> dict[str, tuple[str, ...]]:
        """Default of ``channels`` for a policy without this setting: clocks of data centres, then reactive power."""
        if self.kind == "joint":
            counts = {"datacenter": self.scenario.datacenters.count, "inverter": self.scenario.inverters.count}
            return {"joint": tuple(name for kind, n in counts.items() for name in n * PLAIN_CHANNELS[kind])}
        return {kind: PLAIN_CHANNELS.get(kind, channels) for kind, channels in self.channels.items()}

    @property
    def further_channels(self) -> dict[str, tuple[str, ...]]:
        """Entries of ``channels`` that differ from the default and that a policy must list."""
        known = PLAIN_CHANNELS if self.kind == "shared" else self.plain_channels
        return {name: channels for name, channels in self.channels.items() if channels != known.get(name)}

    def inputs(self, joint: Array) -> dict[str, Any]:
        """Return the inputs of each network: (..., n) for a joint one, (..., n_agent, n) for a kind of agent."""
        if self._visible is not None:
            joint = joint * self._visible
        plates = self.plates(joint) if self.nameplate else ()
        if self.kind == "joint":
            return {"joint": _joined((joint, *plates)) if plates else joint}
        networks = {}
        for kind, group in self.groups.items():
            observed = joint[..., group.seen].reshape(*joint.shape[:-1], group.n, len(group.fields))
            of_group = (plate[..., group.agents, None] for plate in plates)
            networks[kind] = _joined((observed, *of_group)) if plates else observed
        return networks

    def plates(self, joint: Array) -> tuple[Any, Any, Any]:
        """Return the three nameplate inputs, each (..., n_agent); see :class:`Policy`."""
        draw, reach = (joint[..., self._of_all[z]] * scale for z, scale in zip("rx", self._scales_mw, strict=True))
        by = reach if self._reactive is None else _chosen(self._reactive, reach, draw)
        needed = joint[..., self._of_all["v_deviation"]] / by.clip(SMALLEST_REACH, None)
        return draw, reach, needed.clip(-MOST_NEEDED, MOST_NEEDED)

    def action(self, joint: Array, outputs: Mapping[str, Any]) -> Array:
        """Return the joint action, (..., n_action) in [-1, 1], for a joint observation and the network outputs."""
        out = outputs["joint"] if self.kind == "joint" else self._of_agents(joint, outputs)
        if self.outputs != "setpoint":
            before = joint[..., self._of_q["q"]] if self.q_share is None else self.q_share
            q, clock = before + out[..., self._q_at], out[..., self._clock_at]
            if self.outputs != "droop":
                clock = self._clock(joint, 1.0 / self._dt_s) - self._clip(clock, 0.0, 2.0)
            else:
                q = q - joint[..., self._of_q["v_deviation"]] * self._k_q
                more = joint[..., self._of_clock["v_deviation"]] * self._k_p
                clock = self._clock(joint, self._alpha_per_s, more) + clock
            other = () if self._other_rest is None else (self._other_rest + out[..., self._other_at],)
            out = _joined((clock, q, *other))[..., self._back]
        out = self._clip(out, -1.0, 1.0)
        return out if self._at_rest is None else _chosen(self._at_rest, self._rest, out)

    def _of_agents(self, joint: Array, outputs: Mapping[str, Any]) -> Array:
        """Arrange the outputs of the agents' networks in the order of the joint action, (..., n_action)."""
        actions = [outputs[kind].reshape(*joint.shape[:-1], -1) for kind in self.groups]
        return actions[0] if len(actions) == 1 else _joined(actions)

    def _clock(self, joint: Array, backlog_per_s: float, more: Array | float = 0.0) -> Array:
        """Return the clock that serves p_ref, a share of the backlog and ``more``, shares of the rating, (..., n_dc).

        Without p_ref in the observation, it is the maximum clock, reduced if ``more`` is negative.
        """
        backlog_s = joint[..., self._of_clock["backlog"]]
        power = joint[..., self._of_clock["p_ref_next"]] if self._ahead else 0.0 * backlog_s + 1.0
        speed = (power + backlog_per_s * backlog_s + more - self._idle) / (1.0 - self._idle)
        return (2.0 * (speed - self._slowest) / (1.0 - self._slowest) - 1.0).clip(-1.0, 1.0)


def require_one_policy_fits(interfaces: Sequence[PolicyInterface]) -> None:
    """Raise ValueError, with network and scenarios, unless one policy fits all scenarios."""
    first = interfaces[0]
    for interface in interfaces:
        for name, widths in interface.widths.items():
            mine, its = (first.widths.get(name), first.channels.get(name)), (widths, interface.channels[name])
            if name in first.widths and mine != its:
                raise ValueError(
                    f"scenario: the network {name!r} would take and give {mine[0]} figures and give {mine[1]} on "
                    f"{first.scenario.name}, and {its[0]} and {its[1]} on {interface.scenario.name}; train on "
                    "scenarios of the same agents, or on one alone"
                )


def _joined(parts: Sequence[Array]) -> Array:
    return namespace(parts[0]).concat(tuple(parts), axis=-1)


def _chosen(condition: Array, one: Array, other: Array) -> Array:
    return namespace(other).where(condition, one, other)

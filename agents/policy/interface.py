"""What stands between a policy's networks and a scenario: the inputs of each network, and what its outputs do.

Array code for NumPy and torch alike, so that a policy acts in use exactly as it did in training. Outputs are setpoints,
the action itself, or changes of what holds everything as it is, or corrections of a droop law with cumulative memory
(residual learning: T. Johannink et al., "Residual reinforcement learning for robot control", arXiv 1812.03201):

            change                                                                  droop
    clock   that which just serves all work at hand, arriving and queued,           the law's, plus output
            less max(output, 0)
    q       that which is dispatched now, plus output                               the law's, plus output

With changes a law that integrates, as the droop does, is one that ignores most of what it sees, and a policy need not
learn to copy its own reactive power to four digits; and the clock starts where holding it back has an effect.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from array_api_compat import array_namespace

from dcgrid_env import Scenario, action_layout, field_names

KINDS = {"joint": ("joint",), "shared": ("datacenter", "inverter")}
"""Networks of each kind of policy: one for all agents together, or one for each kind of agent."""
SCOPES = ("local", "neighbours", "feeder")
ACTS = ("both", "clock", "q")
OUTPUTS = ("setpoint", "change", "droop")
HIDDEN = ("p_ref_next", "p_ref_next_compute")
"""Fields that a policy without preview is not given."""
SMALLEST_REACH, MOST_NEEDED = 1e-3, 3.0
"""Limits of the nameplate figures: least reach of reactive power, bands, and most of it that a deviation can need."""


class Gains(NamedTuple):
    """Gains of the droop law that the outputs correct, see ``baselines.Droop``."""

    k_p_mw_per_pu: float
    k_q_mvar_per_pu_s: float
    alpha_per_s: float


def cut(x: Any, low: float, high: float) -> Any:
    """``x`` within these limits, elementwise."""
    return x.clip(low, high)


class PolicyInterface:
    """Between a scenario and a policy's networks: their inputs from observations, and actions from their outputs.

    Parameters
    ----------
    scenario
        What is to be driven.
    kind
        ``joint`` or ``shared``, see ``KINDS``.
    preview, act, nameplate, outputs, gains
        Settings of the policy, see :class:`Policy`.
    array
        Makes the arrays to compute with out of NumPy ones: ``np.asarray``, or one that makes tensors.
    clip
        Cuts to a lowest and highest value: ``cut``, or one with another derivative.
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
        array: Callable[[np.ndarray], Any] = np.asarray,
        clip: Callable[[Any, float, float], Any] = cut,
    ):
        names = [field_names(scenario)[agent] for agent in scenario.agents]
        n_dc, n_inv = scenario.n_datacenters, scenario.n_inverters
        self.scenario, self.kind, self.nameplate, self.outputs = scenario, kind, nameplate, outputs
        self._clip = clip
        self.counts = {"datacenter": n_dc, "inverter": n_inv}
        self.split_at, self._n_observed = sum(map(len, names[:n_dc])), sum(map(len, names))
        joined = [name for own in names for name in own]
        visible = np.array([preview or name not in HIDDEN for name in joined])
        self._visible = None if visible.all() else array(visible.astype(np.float32))
        p_scale_kw = np.concatenate((scenario.datacenter.p_rated_kw, scenario.inverter.s_rated_kva))
        self._scales_mw = [array((scale / 1e3).astype(np.float32)) for scale in (p_scale_kw, scenario.q_scale_kvar)]
        clocks = action_layout(scenario).is_channel("clock").astype(np.float32)
        self._n_action = len(clocks)
        self._rest = array(clocks)  # at rest: top clock, no reactive power
        at_rest = {"both": np.zeros(clocks.shape, bool), "q": clocks == 1.0, "clock": clocks == 0.0}[act]
        self._at_rest = array(at_rest) if at_rest.any() else None
        # Positions of clocks and of reactive setpoints in the joint action, and back.
        self._clock_at, self._q_at = (array(np.flatnonzero(clocks == value)) for value in (1.0, 0.0))
        self._back = array(np.argsort(np.concatenate((np.flatnonzero(clocks), np.flatnonzero(clocks == 0.0)))))
        self._columns = {
            field: array(np.array([i for i, name in enumerate(joined) if name == field], dtype=np.int64))
            for field in ("v_deviation", "q", "r", "x", "p_ref_next", "backlog")
        }
        self._idle, self._dt_s = scenario.idle_share, float(scenario.dt_s)
        self._slowest = scenario.f_min_mhz / scenario.f_max_mhz
        self._ahead = preview and scenario.preview
        if gains is not None:
            band = scenario.band_pu or 1.0
            reach_mw = np.where(scenario.q_scale_kvar > 0, scenario.q_scale_kvar, np.inf) / 1e3
            self._k_q = array((gains.k_q_mvar_per_pu_s * self._dt_s * band / reach_mw).astype(np.float32))
            self._k_p = array((gains.k_p_mw_per_pu * band * 1e3 / scenario.datacenter.p_rated_kw).astype(np.float32))
            self._alpha_per_s = gains.alpha_per_s

    @property
    def widths(self) -> dict[str, tuple[int, int]]:
        """Width of what each network that is needed sees, and of what it gives."""
        n_dc, n_inv = self.counts["datacenter"], self.counts["inverter"]
        more = 3 * self.nameplate
        if self.kind == "joint":
            return {"joint": (self._n_observed + more * (n_dc + n_inv), self._n_action)}
        networks = {"datacenter": (self.split_at // n_dc + more, 2)} if n_dc else {}
        return networks | ({"inverter": ((self._n_observed - self.split_at) // n_inv + more, 1)} if n_inv else {})

    def inputs(self, joint: Any) -> dict[str, Any]:
        """What each network sees, (..., n) for a joint one, (..., n_agent, n) for one of single agents."""
        if self._visible is not None:
            joint = joint * self._visible
        if self.kind == "joint":
            return {"joint": joint if not self.nameplate else _joined((joint, *self._plates(joint)))}
        parts = {"datacenter": joint[..., : self.split_at], "inverter": joint[..., self.split_at :]}
        networks, first = {}, 0
        for name, count in self.counts.items():
            if count:
                own = parts[name].reshape(*joint.shape[:-1], count, parts[name].shape[-1] // count)
                if self.nameplate:
                    plates = [figure[..., first : first + count, None] for figure in self._plates(joint)]
                    own = _joined((own, *plates))
                networks[name], first = own, first + count
        return networks

    def _plates(self, joint: Any) -> tuple[Any, Any, Any]:
        """The three figures of the nameplate, (..., n_agent) each, see :class:`Policy`."""
        draw, reach = (joint[..., self._columns[z]] * scale for z, scale in zip("rx", self._scales_mw, strict=True))
        needed = joint[..., self._columns["v_deviation"]] / reach.clip(SMALLEST_REACH, None)
        return draw, reach, needed.clip(-MOST_NEEDED, MOST_NEEDED)

    def action(self, joint: Any, outputs: Mapping[str, Any]) -> Any:
        """The joint action, (..., n_action) in [-1, 1], that the networks' outputs mean after a joint observation."""
        if self.kind == "joint":
            out = outputs["joint"]
        else:
            own = [outputs[name].reshape(*joint.shape[:-1], -1) for name, count in self.counts.items() if count]
            out = own[0] if len(own) == 1 else _joined(own)
        if self.outputs != "setpoint":
            q, clock = joint[..., self._columns["q"]] + out[..., self._q_at], out[..., self._clock_at]
            if self.outputs == "change":
                clock = self._clock(joint, 1.0 / self._dt_s) - self._clip(clock, 0.0, 2.0)
            else:
                v, n_dc = joint[..., self._columns["v_deviation"]], self.counts["datacenter"]
                q = q - v * self._k_q
                clock = self._clock(joint, self._alpha_per_s, v[..., :n_dc] * self._k_p) + clock
            out = _joined((clock, q))[..., self._back]
        out = self._clip(out, -1.0, 1.0)
        return out if self._at_rest is None else _chosen(self._at_rest, self._rest, out)

    def _clock(self, joint: Any, backlog_per_s: float, more: Any = 0.0) -> Any:
        """The clock that allows p_ref, this share of the backlog and ``more``, shares of the rating, (..., n_dc).

        Those that do not see p_ref have the top clock, less what ``more`` takes off the rating.
        """
        backlog_s = joint[..., self._columns["backlog"]]
        power = joint[..., self._columns["p_ref_next"]] if self._ahead else 0.0 * backlog_s + 1.0
        speed = (power + backlog_per_s * backlog_s + more - self._idle) / (1.0 - self._idle)
        return (2.0 * (speed - self._slowest) / (1.0 - self._slowest) - 1.0).clip(-1.0, 1.0)


def require_one_policy_fits(interfaces: Sequence[PolicyInterface]) -> None:
    """ValueError, naming network and scenarios, unless one policy fits all of these scenarios."""
    first = interfaces[0]
    for interface in interfaces:
        for name, widths in interface.widths.items():
            if first.widths.get(name, widths) != widths:
                raise ValueError(
                    f"scenario: the network {name!r} would take and give {first.widths[name]} figures on "
                    f"{first.scenario.name} and {widths} on {interface.scenario.name}; train on scenarios of the same "
                    "agents, or on one alone"
                )


def _joined(parts: Any) -> Any:
    return _namespace(parts[0]).concat(tuple(parts), axis=-1)


def _chosen(condition: Any, one: Any, other: Any) -> Any:
    return _namespace(other).where(condition, one, other)


def _namespace(array: Any) -> Any:
    """NumPy, or torch where it is a tensor of it: both spell what is used here alike."""
    return np if isinstance(array, np.ndarray) else array_namespace(array)

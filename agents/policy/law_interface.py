"""Connect the networks of a model-aided policy to a scenario: inputs from the law, and corrections of its decisions.

The inputs for an agent are quantities of the law (``LawStep``) without units, so they mean the same on any feeder.
Voltages are in bands, reactive power is relative to the agent's maximum, and slopes are relative to the largest slope
that deviations alone can have. The outputs y correct the law's decisions within bounds; 0 leaves them unchanged:

    served power    the law's - SERVED tanh(y) dynamic rating, from 0 to all available work
    q               the law's + tanh(y) (u* - the law's) + REACTIVE tanh(y') largest reactive power, within the limit

The first correction of q moves it towards the static optimum u*, or away from it. If other agents do not act as the
statistics predict, agents can be trapped in a state that no single agent leaves. Moving towards u* resolves it.

The array code runs with NumPy and torch, as in ``interface``.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from dcgrid_env import Scenario, field_names
from dcgrid_env.agents.policy.agent_groups import agent_groups, axes
from dcgrid_env.agents.policy.interface import cut
from dcgrid_env.baselines.model_aided.knowledge import Commissioned, Site
from dcgrid_env.baselines.model_aided.law_step import LawStep, Own, Past, Step
from dcgrid_env.core.arrays import Array, namespace

SERVED, REACTIVE = 0.3, 0.3
"""Bounds of the corrections, relative to dynamic rating and largest reactive power."""
OF_ALL = (
    "deviation", "change", "surprise", "share", "to_rest", "step", "slope", "violation_slope", "mean_deviation",
    "spread", "reach", "own_reach", "crowd", "effort", "draw", "gain", "answered", "damping",
)  # fmt: skip
OF_SITES = ("coming", "backlog", "relief", "cut", "to_serve", "draw_reach")
FEATURES = {"datacenter": (*OF_ALL, *OF_SITES), "inverter": OF_ALL}
"""Names of the network inputs, by kind of agent."""
OUTPUTS = {"datacenter": 3, "inverter": 2}
"""Number of network outputs: served power and two for q, or two for q."""


class Columns:
    """Reads what the agents see out of a joint observation, for NumPy and torch alike."""

    def __init__(self, scenario: Scenario, array: Callable[[np.ndarray], Any]):
        names = [field_names(scenario)[agent] for agent in scenario.agents]
        starts = np.cumsum([0, *map(len, names)])[:-1]
        self._at = {
            name: array(
                np.array(
                    [a + fields.index(name) for a, fields in zip(starts, names, strict=True) if name in fields], int
                )
            )
            for name in ("v_deviation", "v_change", "p", "q", "p_ref_next", "backlog")
        }
        self.band_pu = scenario.cost.band_pu or 1.0
        self._p_scale = array(np.concatenate([device.p_scale_kw for device in scenario.devices]))
        self._q_scale, self._rated_kw = (
            array(scenario.q_scale_kvar),
            array(np.asarray(scenario.datacenters.parameters.p_rated_kw)),
        )

    def of(self, joint: Array) -> Mapping[str, Any]:
        """Fields by name, as observed, of the agents that have them."""
        return {name: joint[:, columns] for name, columns in self._at.items()}

    def physical(self, fields: Mapping[str, Any]) -> Own:
        """Fields in physical units."""
        return Own(
            1.0 + self.band_pu * fields["v_deviation"],
            fields["p"] * self._p_scale,
            fields["q"] * self._q_scale,
            fields["p_ref_next"] * self._rated_kw,
            fields["backlog"] * self._rated_kw,
        )


class LawInterface:
    """Connect a placement to the networks of a model-aided policy.

    Parameters
    ----------
    site, known
        See ``LawStep``.
    array
        Function that converts NumPy arrays.
    clip
        Function that limits values to a range: ``interface.cut``, or one with another derivative.
    tops
        Whether clocks are at their maximum if all work is served, as in the law. Otherwise they have the value that
        just serves it, which has the same effect and a derivative.
    law
        Class that computes a second of the law.
    """

    def __init__(
        self,
        site: Site,
        known: Commissioned,
        *,
        array: Callable[[np.ndarray], Any] = np.asarray,
        clip: Callable[[Any, Any, Any], Any] = cut,
        tops: bool = True,
        law: type[LawStep] = LawStep,
    ):
        s = site.scenario
        self.law = law(site, known, array)
        self.columns = Columns(s, array)
        self._clip, self._tops, self._n_dc = clip, tops, s.datacenters.count
        is_clock, is_q = axes(s)
        self._back = array(np.argsort(np.concatenate([np.flatnonzero(is_clock), np.flatnonzero(is_q)])))
        self.groups = agent_groups(s)
        self._rated_kw = array(np.concatenate([device.p_scale_kw for device in s.devices]))
        self._dynamic_kw = array(np.asarray(s.datacenters.parameters.p_dynamic_kw))
        band = self.columns.band_pu
        response = known.by_q * site.q_scale_kvar[:, None]
        left = (known.by_own * site.q_scale_kvar[:, None]).sum(-1) / np.maximum(response.sum(-1), 1e-12)
        self._answered, self._damping = array(np.clip(left, -1.0, 1.0)), array(np.log(known.alike))
        worth = np.maximum(s.cost.weights.voltage * response.mean(-1), 1e-12)
        still = (response.mean(-1) / band, known.own_by_q * site.q_scale_kvar / band)
        self._worth, self._reach, self._own_reach = array(worth), *(array(_small(a)) for a in still)
        self._effort = array(np.log1p(site.effort / worth))
        drop = known.by_p.mean(-1) * np.concatenate([device.p_scale_kw for device in s.devices]) / band
        gain = (known.gain.mean(2) * response).sum(-1) / np.maximum(response.sum(-1), 1e-12)
        self._gain = array(np.clip(gain, -3.0, 3.0))
        self._drop, self._sum_own = array(_small(drop)), array(np.maximum(response.sum(-1), 1e-12))

    def figures(self, joint: Array, past: Past) -> tuple[Step, Mapping[str, Any]]:
        """Return the law's step for a joint observation and each network's inputs, (row, n_agent of its kind, n)."""
        fields = self.columns.of(joint)
        step = self.law(self.columns.physical(fields), past)
        return step, self._seen(fields, step)

    def _seen(self, fields: Mapping[str, Any], step: Step) -> Mapping[str, Any]:
        xp, band, n_dc = namespace(step.v_pu), self.columns.band_pu, self._n_dc
        e = (step.v_pu - 1.0) / band
        beyond = (xp.tanh(4.0 * (e - 1.0)) + xp.tanh(4.0 * (e + 1.0))) / 2.0
        to_all = step.by_all.sum(-1) / self._sum_own
        like = 0.0 * step.share
        of_all = [
            fields["v_deviation"], fields["v_change"], step.surprise_pu / band, step.share, step.rest - step.share,
            step.chosen - step.share, step.slope / self._worth, beyond.mean(-1), e.mean(-1),
            1.0 / (band * step.inverse_spread.mean(-1)) + like, self._reach + like, self._own_reach + like,
            xp.log1p(to_all) + like, self._effort + like, step.p_kw / self._rated_kw,
            self._gain + like, self._answered + like, self._damping + like,
        ]  # fmt: skip
        every = xp.stack(of_all, axis=-1)
        seen = {}
        if n_dc:
            of_sites = [
                fields["p_ref_next"], fields["backlog"], xp.tanh(step.relief), step.cut_kw / self._dynamic_kw,
                step.all_kw / self._dynamic_kw, self._drop[:, :n_dc] + 0.0 * step.all_kw,
            ]  # fmt: skip
            seen["datacenter"] = xp.concat((every[:, :n_dc], xp.stack(of_sites, axis=-1)), axis=-1)
        if "inverter" in self.groups:
            seen["inverter"] = every[:, n_dc:]
        return seen

    def action(self, step: Step, outputs: Mapping[str, Any]) -> Array:
        """Return the joint action, (row, n_action) in [-1, 1], with the networks' corrections of the law."""
        xp, parts = namespace(step.share), []
        shift, pull = (
            xp.concat([xp.tanh(outputs[kind][..., column]) for kind in self.groups], axis=-1) for column in (-1, -2)
        )
        if self._n_dc:
            less_kw = SERVED * xp.tanh(outputs["datacenter"][..., 0]) * self._dynamic_kw
            waits = (step.cut_kw + less_kw) / step.all_kw.clip(1e-9, None)
            served_kw = step.all_kw * (1.0 - self._clip(waits, 0.0, 1.0))
            clock = self._clip(self.law.clock(step, served_kw), -1.0, 1.0)
            if self._tops:
                clock = xp.where(served_kw < step.all_kw, clock, 1.0 + 0.0 * clock)
            parts.append(clock)
        q = step.chosen + pull * (step.rest - step.chosen) + REACTIVE * shift
        parts.append(self._clip(q, -1.0, 1.0))
        return xp.concat(parts, axis=-1)[..., self._back]


def _small(x: np.ndarray) -> np.ndarray:
    """Compress values of different magnitude to a scale that separates small ones."""
    return np.log(np.maximum(x, 1e-4))

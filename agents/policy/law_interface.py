"""What stands between the networks of a model-aided policy and a scenario: the law's figures in, corrections out.

What a network sees of an agent are figures of the law (``law_step``), all without a unit, so that they mean the same on
any feeder: voltages in bands, reactive power as a share of the agent's own, slopes as a share of the largest that
deviations alone can have. Its outputs y correct the law's decisions within bounds, and 0 leaves them as they are:

    served power    the law's - SERVED tanh(y) dynamic rating, from 0 to all work at hand
    q               the law's + tanh(y) (u* - the law's) + REACTIVE tanh(y') largest reactive power, within the limit

The first of q leads towards the static optimum, or as far away from it: where others do not what the statistics say,
agents may hold each other in a state that none of them leaves alone, and u* is the way out.

Array code for NumPy and torch alike, as ``interface``.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from array_api_compat import array_namespace

from dcgrid_env.agents.policy.agent_groups import agent_groups, axes
from dcgrid_env.agents.policy.interface import cut
from dcgrid_env.agents.policy.law_step import Columns, LawStep, Past, Step
from dcgrid_env.baselines.model_aided.knowledge import Commissioned, Site

SERVED, REACTIVE = 0.3, 0.3
"""Bounds of the corrections: of the dynamic rating, and of the largest reactive power."""
OF_ALL = (
    "deviation", "change", "surprise", "share", "to_rest", "step", "slope", "violation_slope", "mean_deviation",
    "spread", "reach", "own_reach", "crowd", "effort", "draw", "gain", "answered", "damping",
)  # fmt: skip
OF_SITES = ("coming", "backlog", "relief", "cut", "to_serve", "draw_reach")
FEATURES = {"datacenter": (*OF_ALL, *OF_SITES), "inverter": OF_ALL}
"""Names of what the networks see, by the kind of agent."""
OUTPUTS = {"datacenter": 3, "inverter": 2}
"""Width of what they give: served power and twice q, or q alone."""


class LawInterface:
    """Between a placement and the networks of a model-aided policy.

    Parameters
    ----------
    site, known
        See ``LawStep``.
    array
        Makes the arrays to compute with out of NumPy ones.
    clip
        Cuts to a lowest and highest value: ``interface.cut``, or one with another derivative.
    tops
        Whether clocks are at the top where all work is served, as the law has them; else at what just serves it, which
        comes to the same and has a derivative.
    """

    def __init__(
        self,
        site: Site,
        known: Commissioned,
        *,
        array: Callable[[np.ndarray], Any] = np.asarray,
        clip: Callable[[Any, Any, Any], Any] = cut,
        tops: bool = True,
    ):
        s = site.scenario
        self.law = LawStep(site, known, array)
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

    def figures(self, joint: Any, past: Past) -> tuple[Step, Mapping[str, Any]]:
        """The law's step after a joint observation, and what each network sees, (row, n_agent of its kind, n)."""
        fields = self.columns.of(joint)
        step = self.law(self.columns.own(fields), past)
        return step, self._seen(fields, step)

    def _seen(self, fields: Mapping[str, Any], step: Step) -> Mapping[str, Any]:
        xp, band, n_dc = _namespace(step.v_pu), self.columns.band_pu, self._n_dc
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

    def action(self, step: Step, outputs: Mapping[str, Any]) -> Any:
        """The joint action, (row, n_action) in [-1, 1], under the networks' corrections of the law's decisions."""
        xp, parts = _namespace(step.share), []
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
    """Figures of several sizes on a scale that tells the small ones apart."""
    return np.log(np.maximum(x, 1e-4))


def _namespace(array: Any) -> Any:
    return np if isinstance(array, np.ndarray) else array_namespace(array)

"""A second of the model-aided law: its decisions and the figures behind them, on NumPy arrays and tensors alike.

The decisions are those of ``decide``, whatever the arrays.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from dcgrid_env.baselines.model_aided.average import Average
from dcgrid_env.baselines.model_aided.decision import Decision, DecisionInputs, decide, own_error
from dcgrid_env.baselines.model_aided.knowledge import Commissioned, Site, between, by_sun, resting
from dcgrid_env.core.arrays import Array, namespace
from dcgrid_env.devices import site_work

_LEVELLED = ("base_pu", "own_base_pu", "gain", "inverse_spread", "by_all")
"""What the agents know by level of the sun."""


class Own(NamedTuple):
    """What agents see at their own buses, in physical units, (row, n_agent) and of sites (row, n_dc)."""

    v_pu: Array
    p_kw: Array
    q_kvar: Array
    p_ref_next_kw: Array
    backlog_kws: Array


class Past:
    """What agents remember: how many steps they have acted, own powers of the last of them, and their average E."""

    def __init__(self) -> None:
        self.steps, self._powers, self.average = 0, [], Average()

    def when_measured(self, now: Own, delay: int) -> tuple[Any, Any]:
        """Own draw and injection, kW and kvar, at the time that the voltage was measured; ``now`` is remembered."""
        self._powers = [*self._powers, (now.p_kw, now.q_kvar)][-(delay + 1) :]
        return self._powers[0]


class Decided(NamedTuple):
    """The law's decisions and what they go by, (row, n_agent), of sites (row, n_dc)."""

    now: Own
    """What is seen, with the averaged voltage, and in the first steps as if all stood at u*."""
    then_kw: Array
    """Own draw at the time that the voltage was measured."""
    then_kvar: Array
    """Own injection at that time."""
    p_kw: Array
    """Draw if all work is served that is there."""
    all_kw: Array
    """Dynamic power that serves all work that is there, up to the top clock."""
    ceiling_kw: Array
    """Dynamic power of the top clock."""
    seen: DecisionInputs
    """All that the decisions go by, as NumPy arrays."""
    best: Decision


class Step(NamedTuple):
    """The law's decisions and the figures that they are made from, (row, n_agent), of sites (row, n_dc)."""

    v_pu: Array
    """Estimate of every voltage if no setpoint moves, at the draws decided on, (row, n_agent, node)."""
    inverse_spread: Array
    """1 over its standard deviation, (row or 1, n_agent, node)."""
    by_all: Array
    """Rise of each voltage when all inject their whole limit more, (row or 1, n_agent, node)."""
    surprise_pu: Array
    """Own voltage without the own part, less what is expected of it."""
    share: Array
    """Setpoint now, as a share of the largest reactive power."""
    rest: Array
    """The static optimum u*, the same share."""
    chosen: Array
    """The law's new setpoint, the same share."""
    slope: Array
    """Slope of the expected cost by the own setpoint."""
    relief: Array
    """What the first kW less relieves the expected cost by, over the price of letting it wait."""
    p_kw: Array
    """Draw if all work is served that is there."""
    all_kw: Array
    """Dynamic power that serves all work that is there, up to the top clock."""
    cut_kw: Array
    """How much less the law serves."""
    ceiling_kw: Array
    """Dynamic power of the top clock."""


class LawStep:
    """One second of the law in a scenario, for the data of one placement or of one placement per row.

    ``array`` makes the arrays to compute with out of NumPy ones.
    """

    def __init__(self, site: Site, known: Commissioned, array: Callable[[np.ndarray], Any]):
        s = site.scenario
        self.site, self.scenario, self._array = site, s, array
        self._known = known
        self.known = Commissioned(*map(array, known))
        self.by_q = array(known.by_own * site.q_scale_kvar[:, None])
        """What each agent's whole reactive power does to every voltage once the others have answered it, p.u.,
        (placement, n_agent, node)."""
        self._scale = array(site.kvar_share)
        self._dc = {
            name: array(np.asarray(getattr(s.datacenters.parameters, name))) for name in ("p_idle_kw", "p_dynamic_kw")
        }
        self._n_dc = s.datacenters.count

    def decide(self, now: Own, past: Past) -> Decided:
        """Decide for what is seen now, which ``past`` then contains too."""
        known, site, s, like = self.known, self.site, self.scenario, self._like
        idle_kw, all_kw, ceiling_kw = self.work(now)
        p_kw = _joined((idle_kw + all_kw, now.p_kw[:, self._n_dc :]))
        rest_kvar = resting(site, self._known, _host(p_kw))
        then_kw, then_kvar = past.when_measured(now, s.sensing.delay_steps)
        # All begin without reactive power, and go on as if they stood at u*.
        if past.steps <= s.sensing.delay_steps:
            start_pu = by_sun(site, self._known.start_pu, self._known.rest_at, _host(then_kw))
            now, then_kvar = now._replace(v_pu=now.v_pu + like(start_pu)), like(rest_kvar)
        if past.steps == 0:
            now = now._replace(q_kvar=like(rest_kvar))
        past.steps += 1
        if s.sensing.noise_pu:
            e_own = own_error(known, now.v_pu, then_kw, then_kvar)
            now = now._replace(v_pu=now.v_pu + past.average(known, e_own) - e_own)
        least_kw = np.minimum(_host(ceiling_kw) * s.datacenters.f_min_mhz / s.datacenters.f_max_mhz, _host(all_kw))
        seen = DecisionInputs(
            _host(now.v_pu), _host(then_kw), _host(then_kvar), _host(now.q_kvar), _host(p_kw),
            _host(all_kw) - least_kw, rest_kvar,
        )  # fmt: skip
        best = decide(site, self._known, seen)
        return Decided(now, then_kw, then_kvar, p_kw, all_kw, ceiling_kw, seen, best)

    def __call__(self, now: Own, past: Past) -> Step:
        """The law's decisions for what is seen now, which ``past`` then contains too, and the figures behind them."""
        known, site, n_dc, like = self.known, self.site, self._n_dc, self._like
        found = self.decide(now, past)
        now, then_kw, then_kvar, p_kw, all_kw, ceiling_kw, seen, best = found
        base, own_base, gain, inverse, by_all = self._at_level(seen.v_pu, seen.then_kw, seen.then_kvar)
        e_own = now.v_pu - known.own_by_q * (then_kvar - known.origin_kvar)
        surprise = e_own + known.own_by_draw * (then_kw - known.mean_kw) - own_base
        v = base + gain * surprise[..., None] + known.by_q * (now.q_kvar - known.origin_kvar)[..., None]
        v = v - known.by_draw * (p_kw - known.mean_kw)[..., None]
        share, rest = now.q_kvar / self._scale, like(seen.rest_kvar) / self._scale
        cut_kw = self._cut(v[:, :n_dc], inverse[:, :n_dc], found)
        if n_dc:
            v = _joined((v[:, :n_dc] + known.by_draw[:, :n_dc] * cut_kw[..., None], v[:, n_dc:]), 1)
        chosen = self._respond(v, inverse, known.alike[..., None] * by_all, share, rest, found)
        chosen = chosen + site.law.pull * self._pulled * (rest - chosen)
        relief = like(best.relief) / known.waiting.clip(1e-12, None)
        return Step(
            v, inverse, by_all, surprise, share, rest, chosen, like(best.slope), relief, p_kw, all_kw, cut_kw,
            ceiling_kw,
        )  # fmt: skip

    def _cut(self, v: Array, inverse: Array, found: Decided) -> Array:
        """How much less than all work to serve, kW; a subclass adds a derivative."""
        return self._like(found.best.cut_kw)

    def _respond(self, v: Array, inverse: Array, by_all: Array, share: Array, rest: Array, found: Decided) -> Array:
        """The new setpoint as a share; a subclass adds a derivative."""
        return self._like(found.best.share)

    def clock(self, step: Step, served_kw: Array) -> Array:
        """Clock that serves so much, in [-1, 1] where there is one, (row, n_dc)."""
        slowest = self.scenario.datacenters.f_min_mhz / self.scenario.datacenters.f_max_mhz
        return 2.0 * (served_kw / step.ceiling_kw - slowest) / ((1.0 - slowest) or 1.0) - 1.0

    def _like(self, values: np.ndarray) -> Array:
        return self._array(np.asarray(values))

    @property
    def _pulled(self) -> Array:
        return self._like(np.asarray(self.site.scheduled, dtype=float))

    def work(self, now: Own) -> tuple[Any, Any, Any]:
        """Idle floor, dynamic power that serves all work that is there, and that of the top clock, kW, (row, n_dc)."""
        s, xp, idle = self.scenario, namespace(now.v_pu), self._dc["p_idle_kw"]
        p_ref_kw = now.p_ref_next_kw
        if not s.sensing.preview:
            p_ref_kw = xp.maximum(self.known.mean_kw[:, : self._n_dc], idle) + 0.0 * now.backlog_kws
        arriving_kw = site_work.arriving(idle, p_ref_kw)
        ceiling_kw = site_work.top_power(self._dc["p_dynamic_kw"], arriving_kw)
        all_kw = xp.minimum(ceiling_kw, site_work.at_hand(now.backlog_kws, arriving_kw, s.dt_s))
        return site_work.idle_draw(idle, p_ref_kw), all_kw, ceiling_kw

    def _at_level(self, v_pu: np.ndarray, then_kw: np.ndarray, then_kvar: np.ndarray) -> list[Any]:
        """What the agents know at the level of the sun that they see, see ``_LEVELLED``."""
        known = self._known
        if known.key.shape[-1] == 1:
            return [getattr(self.known, name)[:, :, 0] for name in _LEVELLED]
        e_own = own_error(known, v_pu, then_kw, then_kvar)
        key = np.broadcast_to(known.key, (len(e_own), *known.key.shape[1:]))
        low, weight = between(np.where(self.site.scheduled, then_kw, e_own), key)
        row = np.arange(len(low))[:, None] if len(known.key) > 1 else np.zeros((1, 1), int)
        agent, out = np.arange(low.shape[1]), []
        for name in _LEVELLED:
            a, b = (getattr(known, name)[row, agent, low + more] for more in (0, 1))
            part = weight if a.ndim == 2 else weight[..., None]
            out.append(self._like(a + part * (b - a)))
        return out


def _joined(parts: tuple[Any, ...], axis: int = -1) -> Array:
    return namespace(parts[0]).concat(parts, axis=axis)


def _host(values: Array) -> Array:
    """NumPy's form of an array, float64."""
    return values if isinstance(values, np.ndarray) else values.detach().cpu().double().numpy()

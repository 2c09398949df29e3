"""The model-aided law's step on NumPy arrays or torch tensors, with a derivative, and the figures it goes by.

``baselines.model_aided`` is the law; what it works out at commissioning is taken from there as it is. Here is only what
it does each second, written for arrays of either kind, so that a policy on top of it is trained on what it acts on.
Both of the law's decisions are zeros of rising functions, found by halving an interval, which has no derivative. On
tensors they get that of the implicit function: with F(t, x) = 0

    dt/dx = -(dF/dx) / (dF/dt)

while the value stays that of the halvings; where a limit stops t there is none.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import nullcontext
from typing import Any, NamedTuple

import numpy as np
from array_api_compat import array_namespace
from scipy import special

from dcgrid_env import Scenario, field_names
from dcgrid_env.baselines.model_aided.commissioning import Commissioned, Site
from dcgrid_env.baselines.model_aided.expected_cost import VoltagePrice

HALVINGS = 10
_KINK = 1e-3  # share of the limit over which the price of effort turns, that of the law
_SQRT_2_PI = float(np.sqrt(2.0 * np.pi))


class Seen(NamedTuple):
    """What the agents see at their own buses, in physical units, (lane, n_agent) and of sites (lane, n_dc)."""

    v_pu: Any
    p_kw: Any
    q_kvar: Any
    p_ref_next_kw: Any
    backlog_kws: Any


class Step(NamedTuple):
    """The law's decisions and what they are made from; (lane, n_agent), of sites (lane, n_dc), with k nodes behind."""

    v_pu: Any
    """Estimate of every voltage if no setpoint moves, at the draws decided on, (lane, n_agent, k)."""
    s_pu: Any
    by_all: Any
    surprise_pu: Any
    """Own voltage without own part, less what the model expects of it."""
    share: Any
    """Setpoint now, of the largest reactive power."""
    rest: Any
    """The static optimum u*."""
    limit: Any
    """Largest setpoint at the coming draw."""
    chosen: Any
    """New setpoint, before it is cut to 1."""
    slope: Any
    """Slope of the expected cost by the own setpoint where it is now."""
    p_kw: Any
    """Draw of the coming step."""
    all_kw: Any
    """Dynamic power that would serve all work at hand."""
    served_kw: Any
    ceiling_kw: Any
    """Dynamic power of the top clock."""
    cut: Any
    """Whether less than all is to be served, bool."""
    relief: Any
    """What a kW less would save of the expected cost if all is served, over the price of letting it wait."""


class LawStep:
    """The law's step in a scenario for what its agents know of a placement.

    Parameters
    ----------
    site, known
        Of ``baselines.model_aided``; ``known`` with a leading lane, one lane where all are on the same placement.
    price
        Price of letting work wait, as a share of what MPC charges.
    array
        Makes the arrays to compute with out of NumPy ones.
    """

    def __init__(self, site: Site, known: Commissioned, price: float, array: Callable[[np.ndarray], Any]):
        s = site.scenario
        self.scenario, self.law, self._price = s, site.law, VoltagePrice.of(s)
        self.known = Commissioned(*map(array, known))
        self._n_dc = s.n_datacenters
        dc = s.datacenter
        self.waiting = price * (s.weights.backlog + s.weights.leftover) * s.dt_s / (dc.p_rated_kw.sum() or 1.0)
        self._idle_kw, self._dynamic_kw = array(np.asarray(dc.p_idle_kw)), array(np.asarray(dc.p_dynamic_kw))
        self._rated_kva, self.q_scale = array(site.s_rated_kva), array(site.q_scale_kvar)
        self._scale, self.effort = array(site.share_of_kvar), array(site.effort)
        self._scheduled = array(np.asarray(site.scheduled, dtype=float))
        kva = np.ones(s.n_agents)
        kva[self._n_dc :][: len(s.scheduled_kva)] = np.where(s.scheduled_kva > 0, s.scheduled_kva, 1.0)
        self._kva = array(kva)
        self._agents = array(np.arange(s.n_agents))
        self._levels = known.key.shape[-1]
        self.by_own = self.known.by_q * self.q_scale[:, None]
        """What each agent does to every voltage by its whole reactive power, p.u., (lane, n_agent, k)."""

    def __call__(self, now: Seen, then_p_kw: Any, then_q_kvar: Any) -> Step:
        """The law's decisions; own powers of the time that the voltage was measured, (lane, n_agent)."""
        known, n_dc = self.known, self._n_dc
        e_own = now.v_pu - known.own_by_q * (then_q_kvar - known.origin_kvar)
        e_own = e_own + known.own_by_draw * (then_p_kw - known.mean_kw)
        v, s_pu, by_all, expected = self._estimate(e_own, then_p_kw)
        v = v + known.by_q * (now.q_kvar - known.origin_kvar)[..., None]
        idle_kw, all_kw, ceiling_kw = self._work(now)
        p_kw = _joined((idle_kw + all_kw, now.p_kw[:, n_dc:]))
        v = v - known.by_draw * (p_kw - known.mean_kw)[..., None]
        served_kw, cut, relief = self._serve(v[:, :n_dc], s_pu[:, :n_dc], all_kw, ceiling_kw)
        v = _joined((v[:, :n_dc] + known.by_draw[:, :n_dc] * (all_kw - served_kw)[..., None], v[:, n_dc:]), 1)
        p_kw = _joined((idle_kw + served_kw, now.p_kw[:, n_dc:]))
        room = (self._rated_kva**2 - p_kw**2).clip(0.0, None) ** 0.5
        xp = _namespace(room)
        limit = xp.minimum(self.q_scale + 0.0 * room, room) / self._scale
        share, rest = now.q_kvar / self._scale, self._rest(p_kw) / self._scale
        chosen = self._respond(v, s_pu, self.law.alike * by_all, share, limit, rest)
        chosen = chosen + self.law.pull * self._scheduled * (rest - chosen)
        slope = (self._slope(v, s_pu) * self.by_own).sum(-1)
        return Step(
            v, s_pu, by_all, e_own - expected, share, rest, limit, chosen, slope, p_kw, all_kw, served_kw, ceiling_kw,
            cut, relief,
        )  # fmt: skip

    def _estimate(self, e_own: Any, p_kw: Any) -> tuple[Any, Any, Any, Any]:
        """E[E_k | E_i], its spread, ``by_all``, and what is expected of E_i; as ``commissioning.estimate``."""
        known = self.known
        if self._levels == 1:
            at = known.own_base_pu[..., 0]
            e = known.base_pu[:, :, 0] + known.gain[:, :, 0] * (e_own - at)[..., None]
            return e, known.spread_pu[:, :, 0] + 0.0 * e, known.by_all[:, :, 0] + 0.0 * e, at
        xp = _namespace(e_own)
        low, weight = _between(xp.where(self._scheduled > 0, p_kw, e_own), known.key)
        lane = 0 * low[:, :1] if len(known.key) == 1 else _counted(low)
        total: Any = None
        for at, share in ((low, 1.0 - weight), (low + 1, weight)):
            where = lane, self._agents, at
            own = known.own_base_pu[where]
            e = known.base_pu[where] + known.gain[where] * (e_own - own)[..., None]
            parts = [share[..., None] * a for a in (e, known.spread_pu[where], known.by_all[where])]
            parts.append(share * own)
            total = parts if total is None else [a + b for a, b in zip(total, parts, strict=True)]
        return tuple(total)

    def _rest(self, p_kw: Any) -> Any:
        """u* at a draw, kvar, (lane, n_agent); as ``commissioning.resting``."""
        known, xp = self.known, _namespace(p_kw)
        mean = known.rest_kvar.mean(1) + 0.0 * p_kw
        if known.rest_at.shape[-1] == 1:
            return mean
        low, weight = _between(p_kw / self._kva, known.rest_at[:, None] + 0.0 * p_kw[..., None])
        lane = 0 * low[:, :1] if len(known.key) == 1 else _counted(low)
        a, b = (known.rest_kvar[lane, low + more, self._agents] for more in (0, 1))
        return xp.where(self._scheduled > 0, a + weight * (b - a), mean)

    def _work(self, now: Seen) -> tuple[Any, Any, Any]:
        """Idle floor, dynamic power that serves all work at hand, and that of the top clock, kW, (lane, n_dc)."""
        p_ref, xp = now.p_ref_next_kw, _namespace(now.v_pu)
        if not self.scenario.preview:
            mean = xp.maximum(self.known.mean_kw[:, : self._n_dc], self._idle_kw)
            p_ref = mean + 0.0 * now.backlog_kws
        idle_kw = xp.minimum(p_ref, self._idle_kw)
        arrives_kw = (p_ref - self._idle_kw).clip(0.0, None)
        ceiling_kw = xp.maximum(self._dynamic_kw, arrives_kw)
        return idle_kw, xp.minimum(ceiling_kw, arrives_kw + now.backlog_kws / self.scenario.dt_s), ceiling_kw

    def _serve(self, v: Any, s_pu: Any, all_kw: Any, ceiling_kw: Any) -> tuple[Any, Any, Any]:
        """Dynamic power to serve, kW, whether it is cut, and the relief of serving less over its price, (lane, n_dc)."""
        known, n_dc = self.known, self._n_dc
        by_p, by_draw = known.by_p[:, :n_dc], known.by_draw[:, :n_dc]
        waiting, s, xp = self.waiting or 1e-12, self.scenario, _namespace(all_kw)

        def relief(served_kw: Any) -> Any:
            then = v + by_draw * (all_kw - served_kw)[..., None]
            return -(self._slope(then, s_pu) * by_p).sum(-1)

        of_all = relief(all_kw)
        cut = of_all > self.waiting
        low = xp.minimum(ceiling_kw * s.f_min_mhz / s.f_max_mhz, all_kw)
        if not bool(cut.any()):
            return all_kw, cut, of_all / waiting
        with _untracked(all_kw):
            at_least, high = low, all_kw + 0.0
            for _ in range(HALVINGS):
                middle = (low + high) / 2.0
                less = relief(middle) > self.waiting
                low, high = xp.where(less, low, middle), xp.where(less, middle, high)
        found = low
        if _tracks(all_kw) or _tracks(v):
            then = v + by_draw * (all_kw - found)[..., None]
            steep = (self._curve(then, s_pu) * by_p * by_draw).sum(-1)
            inside = found > at_least + 1e-3 * ceiling_kw
            found = _implicit(found, relief(found), steep, inside)
        return xp.where(cut, found, all_kw), cut, of_all / waiting

    def _respond(self, v: Any, s_pu: Any, by_all: Any, share: Any, limit: Any, rest: Any) -> Any:
        """Where the own slope of the cost is zero if all move alike; as ``best_response``."""
        xp, hold = _namespace(v), self.law.hold

        def rise(middle: Any) -> Any:
            then = v + (middle - share)[..., None] * by_all
            own = (self._slope(then, s_pu) * self.by_own).sum(-1)
            return own + self.effort * xp.tanh(middle / _KINK) + hold * (middle - rest)

        with _untracked(v):
            low, high = -limit, xp.maximum(limit, -limit)
            for _ in range(HALVINGS):
                middle = (low + high) / 2.0
                below = rise(middle) < 0.0
                low, high = xp.where(below, middle, low), xp.where(below, high, middle)
            found = (low + high) / 2.0
        if not _tracks(v):
            return found
        then = v + (found - share)[..., None] * by_all
        steep = (self._curve(then, s_pu) * self.by_own * by_all).sum(-1) + hold
        steep = steep + self.effort / _KINK / xp.cosh((found / _KINK).clip(-30.0, 30.0)) ** 2
        inside = abs(found) < (1.0 - 2.0**-HALVINGS) * limit
        return _implicit(found, rise(found), steep, inside)

    def _slope(self, v: Any, s_pu: Any) -> Any:
        """Slope of the expected cost, as ``VoltagePrice.slope``."""
        e, b = (v - 1.0) / s_pu, self._price.band_pu / s_pu
        return self._price.voltage * (2.0 * _ndtr(e) - 1.0) + self._price.violation * (_ndtr(e - b) - _ndtr(-e - b))

    def _curve(self, v: Any, s_pu: Any) -> Any:
        """Its derivative."""
        e, b = (v - 1.0) / s_pu, self._price.band_pu / s_pu
        far = self._price.violation * (_density(e - b) + _density(e + b))
        return (2.0 * self._price.voltage * _density(e) + far) / s_pu

    def clock(self, step: Step, served_kw: Any) -> Any:
        """Clock that serves so much, in [-1, 1], (lane, n_dc)."""
        s = self.scenario
        slowest = s.f_min_mhz / s.f_max_mhz
        return 2.0 * (served_kw / step.ceiling_kw - slowest) / ((1.0 - slowest) or 1.0) - 1.0


class Columns:
    """Reads what the agents see out of a joint observation, for NumPy and torch alike."""

    def __init__(self, scenario: Scenario, array: Callable[[np.ndarray], Any]):
        names = [field_names(scenario)[agent] for agent in scenario.agents]
        starts = np.cumsum([0, *map(len, names)])[:-1]
        self._at = {
            name: array(np.array([a + own.index(name) for a, own in zip(starts, names, strict=True) if name in own]))
            for name in ("v_deviation", "v_change", "p", "q", "p_ref_next", "backlog")
        }
        self.band_pu = scenario.band_pu or 1.0
        self._p_scale = array(np.concatenate([device.p_scale_kw for device in scenario.devices]))
        self.q_scale, self._rated_kw = array(scenario.q_scale_kvar), array(scenario.datacenter.p_rated_kw)

    def of(self, joint: Any) -> Mapping[str, Any]:
        """Fields by name, as observed."""
        return {name: joint[:, at] for name, at in self._at.items()}

    def seen(self, fields: Mapping[str, Any]) -> Seen:
        """The same in physical units."""
        return Seen(
            1.0 + self.band_pu * fields["v_deviation"],
            fields["p"] * self._p_scale,
            fields["q"] * self.q_scale,
            fields["p_ref_next"] * self._rated_kw,
            fields["backlog"] * self._rated_kw,
        )


def _between(value: Any, knots: Any) -> tuple[Any, Any]:
    """As ``commissioning.between``, on the knots of each value, (lane or 1, n_agent, L)."""
    low = (value[..., None] >= knots[..., 1:-1]).sum(-1)
    wide = knots + 0.0 * value[..., None]
    xp = _namespace(value)
    a, b = (xp.take_along_axis(wide, (low + more)[..., None], axis=-1)[..., 0] for more in (0, 1))
    return low, ((value - a) / (b - a).clip(1e-12, None)).clip(0.0, 1.0)


def _implicit(found: Any, function: Any, steep: Any, inside: Any) -> Any:
    """``found`` with the derivative of the implicit function, 0 unless ``inside``."""
    moved = (function - function.detach()) / steep.detach().clip(1e-9, None)
    return found.detach() - _namespace(found).where(inside, moved, 0.0 * moved)


def _ndtr(x: Any) -> Any:
    if isinstance(x, np.ndarray):
        return special.ndtr(x)
    import torch

    return torch.special.ndtr(x)


def _density(x: Any) -> Any:
    return _namespace(x).exp(-0.5 * x * x) / _SQRT_2_PI


def _joined(parts: tuple[Any, ...], axis: int = -1) -> Any:
    return _namespace(parts[0]).concat(parts, axis=axis)


def _counted(rows: Any) -> Any:
    """Number of each row, (row, 1)."""
    return (_namespace(rows).ones_like(rows[:, :1])).cumsum(0) - 1


def _tracks(x: Any) -> bool:
    """Whether it is a tensor whose derivative is asked for."""
    return bool(getattr(x, "requires_grad", False))


def _untracked(x: Any) -> Any:
    """A block in which nothing of tensors is recorded."""
    if isinstance(x, np.ndarray):
        return nullcontext()
    import torch

    return torch.no_grad()


def _namespace(array: Any) -> Any:
    return np if isinstance(array, np.ndarray) else array_namespace(array)

"""The model-aided law's second for a policy on top of it: its decisions, the figures behind them, and their derivative.

The decisions are those of ``baselines.model_aided.decide``, whatever the arrays. On torch tensors they get the
derivative of the implicit function, as both are zeros of rising functions: with F(t, x) = 0

    dt/dx = -(dF/dx) / (dF/dt)

where no limit stops t, and 0 where one does. So a policy is trained through the law on what it acts on.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from types import ModuleType
from typing import Any, NamedTuple

import numpy as np
from array_api_compat import array_namespace

from dcgrid_env import Scenario, field_names
from dcgrid_env.baselines.model_aided.average import Average
from dcgrid_env.baselines.model_aided.decision import DecisionInputs, decide, own_error
from dcgrid_env.baselines.model_aided.expected_cost import VoltagePrice
from dcgrid_env.baselines.model_aided.knowledge import Commissioned, Site, between, by_sun, resting
from dcgrid_env.core.arrays import Array
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
        self._price = VoltagePrice.from_scenario(s)
        self.known = Commissioned(*map(array, known))
        self.by_q = array(known.by_own * site.q_scale_kvar[:, None])
        """What each agent's whole reactive power does to every voltage once the others have answered it, p.u.,
        (placement, n_agent, node)."""
        self._scale, self._effort = array(site.kvar_share), array(site.effort)
        self._dc = {
            name: array(np.asarray(getattr(s.datacenters.parameters, name))) for name in ("p_idle_kw", "p_dynamic_kw")
        }
        self._n_dc = s.datacenters.count

    def __call__(self, now: Own, past: Past) -> Step:
        """The law's decisions for what is seen now, which ``past`` then holds too."""
        known, site, n_dc, like = self.known, self.site, self._n_dc, self._like
        idle_kw, all_kw, ceiling_kw = self._work(now)
        p_kw = _joined((idle_kw + all_kw, now.p_kw[:, n_dc:]))
        rest_kvar = resting(site, self._known, _host(p_kw))
        then_kw, then_kvar = past.when_measured(now, self.scenario.sensing.delay_steps)
        # All begin without reactive power, and go on as if they stood at u*, as in the law.
        if past.steps <= self.scenario.sensing.delay_steps:
            start_pu = by_sun(site, self._known.start_pu, self._known.rest_at, _host(then_kw))
            now, then_kvar = now._replace(v_pu=now.v_pu + like(start_pu)), like(rest_kvar)
        if past.steps == 0:
            now = now._replace(q_kvar=like(rest_kvar))
        past.steps += 1
        if self.scenario.sensing.noise_pu:
            e_own = own_error(known, now.v_pu, then_kw, then_kvar)
            now = now._replace(v_pu=now.v_pu + past.average(known, e_own) - e_own)
        then = _host(then_kw), _host(then_kvar)
        v_host, kvar, p_host = _host(now.v_pu), _host(now.q_kvar), _host(p_kw)
        slowest = self.scenario.datacenters.f_min_mhz / self.scenario.datacenters.f_max_mhz
        span_kw = _host(all_kw) - np.minimum(_host(ceiling_kw) * slowest, _host(all_kw))
        best = decide(site, self._known, DecisionInputs(v_host, then[0], then[1], kvar, p_host, span_kw, rest_kvar))
        base, own_base, gain, inverse, by_all = self._at_level(v_host, *then)
        e_own = now.v_pu - known.own_by_q * (then_kvar - known.origin_kvar)
        surprise = e_own + known.own_by_draw * (then_kw - known.mean_kw) - own_base
        v = base + gain * surprise[..., None] + known.by_q * (now.q_kvar - known.origin_kvar)[..., None]
        v = v - known.by_draw * (p_kw - known.mean_kw)[..., None]
        share, rest = now.q_kvar / self._scale, like(rest_kvar) / self._scale
        cut_kw, chosen = like(best.cut_kw), like(best.share)
        if _tracks(v):
            inside = like((best.cut_kw > 0.0) & (best.cut_kw < span_kw))
            cut_kw = self._cut(v[:, :n_dc], inverse[:, :n_dc], cut_kw, inside)
        if n_dc:
            v = _joined((v[:, :n_dc] + known.by_draw[:, :n_dc] * cut_kw[..., None], v[:, n_dc:]), 1)
        if _tracks(v):
            chosen = self._respond(v, inverse, known.alike[..., None] * by_all, share, chosen, rest, p_host)
        chosen = chosen + site.law.pull * self._pulled * (rest - chosen)
        relief = like(best.relief) / known.waiting.clip(1e-12, None)
        return Step(
            v, inverse, by_all, surprise, share, rest, chosen, like(best.slope), relief, p_kw, all_kw, cut_kw,
            ceiling_kw,
        )  # fmt: skip

    def clock(self, step: Step, served_kw: Array) -> Array:
        """Clock that serves so much, in [-1, 1] where there is one, (row, n_dc)."""
        slowest = self.scenario.datacenters.f_min_mhz / self.scenario.datacenters.f_max_mhz
        return 2.0 * (served_kw / step.ceiling_kw - slowest) / ((1.0 - slowest) or 1.0) - 1.0

    def _like(self, values: np.ndarray) -> Array:
        return self._array(np.asarray(values))

    @property
    def _pulled(self) -> Array:
        return self._like(np.asarray(self.site.scheduled, dtype=float))

    def _work(self, now: Own) -> tuple[Any, Any, Any]:
        """Idle floor, dynamic power that serves all work that is there, and that of the top clock, kW, (row, n_dc)."""
        s, xp, idle = self.scenario, _namespace(now.v_pu), self._dc["p_idle_kw"]
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

    def _cut(self, v: Array, inverse: Array, cut_kw: Array, inside: Array) -> Array:
        """``cut_kw`` with its derivative."""
        by_p, by_draw = self.known.by_p[:, : self._n_dc], self.known.by_draw[:, : self._n_dc]
        then = v + by_draw * cut_kw[..., None]
        slope, curve = self._slopes(then, inverse)
        return _implicit(cut_kw, (slope * by_p).sum(-1), (curve * by_p * by_draw).sum(-1), inside)

    def _respond(
        self, v: Array, inverse: Array, by_all: Array, share: Array, chosen: Array, rest: Array, p_kw: np.ndarray
    ) -> Array:  # fmt: skip
        """``chosen`` with its derivative."""
        limit = self._like(self.site.limit_kvar(p_kw)) / self._scale
        slope, curve = self._slopes(v + (chosen - share)[..., None] * by_all, inverse)
        rise = (slope * self.by_q).sum(-1) + self.known.hold * (chosen - rest)
        steep = (curve * self.by_q * by_all).sum(-1) + self.known.hold
        inside = (abs(chosen) < 0.999 * limit) & (abs(chosen) > 0.0)
        return _implicit(chosen, rise, steep, inside)

    def _slopes(self, v: Array, inverse: Array) -> tuple[Any, Any]:
        """Slope of the expected cost by each expected voltage, and its slope; see ``VoltagePrice``."""
        import torch

        price, x, b = self._price, (v - 1.0) * inverse, self._price.band_pu * inverse
        phi = torch.special.ndtr
        slope = price.voltage * (2.0 * phi(x) - 1.0) + price.violation * (phi(x - b) - phi(-x - b))
        density = [torch.exp(-0.5 * z.detach() ** 2) / (2.0 * np.pi) ** 0.5 for z in (x, x - b, x + b)]
        return slope, (2.0 * price.voltage * density[0] + price.violation * (density[1] + density[2])) * inverse


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


def _implicit(found: Array, function: Array, steep: Array, inside: Array) -> Array:
    """``found`` with the derivative of the implicit function where ``inside``, else none."""
    moved = (function - function.detach()) / steep.detach().clip(1e-9, None)
    return found - _namespace(found).where(inside, moved, 0.0 * moved)


def _joined(parts: tuple[Any, ...], axis: int = -1) -> Array:
    return _namespace(parts[0]).concat(parts, axis=axis)


def _host(values: Array) -> Array:
    """NumPy's form of an array, float64."""
    return values if isinstance(values, np.ndarray) else values.detach().cpu().double().numpy()


def _tracks(x: Array) -> bool:
    """Whether it is a tensor whose derivative is asked for."""
    return bool(getattr(x, "requires_grad", False))


def _namespace(array: Array) -> ModuleType:
    return np if isinstance(array, np.ndarray) else array_namespace(array)

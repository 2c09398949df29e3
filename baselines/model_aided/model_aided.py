"""A local law from the feeder's model, without learning: each agent acts on what its own voltage says of all others.

At commissioning an agent is given the model of the feeder, the places and ratings of all agents and the statistics of
load, work and sun (``commissioning``). From then on it sees what every agent sees: its own voltage, powers, backlog and
coming work. Each second it

1. takes its own part out of its voltage, E_i = V_i - X_ii (q_i - u*_i) + D_ii (p_i - mean p_i),
2. estimates every voltage of the coming second from that, with its error,
       V^_k = E[E_k | E_i] + X_ik (q_i - u*_i) - D_ik (p_next - mean p_i),
3. data centres: serves work as long as the relief of the expected cost by a kW less, sum_k -c'(V^_k) R_ik, is below the
   price of letting it wait, (w_backlog + w_leftover) dt / sum p_rated, that of MPC: charged as if left at the end,
4. sets its reactive power where its own slope of the expected cost is zero if all move alike (``best_response``); an
   inverter that sees the sun is pulled towards the optimum of that level.

It knows more than a law of local measurements does and less than MPC, which sees all voltages: its scope is
``model-aided``. Under a delay of the measurement it takes the powers of that time; a hidden p_ref is taken at its mean.
Equipment that is an agent follows its own control; cost terms beside voltage, backlog and effort are not weighed.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from dcgrid_env import Scenario
from dcgrid_env.baselines.controller import Local, LocalController, require_draws_of_work, require_known_devices
from dcgrid_env.baselines.model_aided.best_response import best_response
from dcgrid_env.baselines.model_aided.commissioning import Commissioned, Law, Site, commission, estimate, resting
from dcgrid_env.baselines.model_aided.expected_cost import VoltagePrice
from dcgrid_env.baselines.model_aided.operating_points import operating_points
from dcgrid_env.baselines.parameter_checks import require_non_negative

MOMENTS = 240
"""Moments of the operation that statistics are over; twice as many where levels of the sun divide them."""
_HALVINGS = 10


@dataclass
class ModelAided(LocalController):
    """The model-aided local law.

    Parameters
    ----------
    floor_pu
        Least standard deviation of an estimated voltage, p.u.: what the model cannot know of itself.
    alike
        Share of the others' limits that is taken to move as the agent moves; below it reacts faster, above slower.
    hold
        Price of being a whole limit away from the static optimum, in units of the cost.
    pull
        Share of the way to the optimum of its level of the sun that an inverter with a schedule goes at each step.
    price
        Price of letting work wait, as a share of what MPC charges.
    """

    floor_pu: float = 0.001
    alike: float = 0.7
    hold: float = 0.01
    pull: float = 0.3
    price: float = 1.0

    scope: ClassVar[str] = "model-aided"

    def __post_init__(self) -> None:
        own = {name: getattr(self, name) for name in ("floor_pu", "alike", "hold", "pull", "price")}
        require_non_negative("model-aided", **own)
        if self.floor_pu == 0.0:
            raise ValueError("model-aided: floor_pu is 0; give a standard deviation > 0")

    def reset(self, env_info: Scenario) -> None:
        """Begin new episodes; ValueError for devices, or sites that draw otherwise, than this law is made for."""
        super().reset(env_info)
        s = self.scenario
        require_known_devices("model-aided", s)
        require_draws_of_work("model-aided", s)
        effort = s.weights.effort / s.n_agents / self._rated_kva * self._q_scale
        points = operating_points(s, MOMENTS * (1 if s.schedule is None else 2))
        law = Law(self.floor_pu, self.alike, self.hold, self.pull)
        self._site = Site(s, points, self._q_scale, self._rated_kva, effort, law)
        self._price = VoltagePrice.of(s)
        self._known: Commissioned | None = None
        self._past: list[tuple[np.ndarray, np.ndarray]] = []
        fixed = [device.buses for device in s.devices if device.count]
        if all(buses is not None for buses in fixed):
            self._commission(np.array([[s.feeder.index(bus) for buses in fixed for bus in buses or ()]]))

    @property
    def site(self) -> Site:
        """What is the same in all placements, after ``reset``."""
        return self._site

    @property
    def known(self) -> Commissioned | None:
        """What the agents know at their places, stacked over lanes; None before they are placed."""
        return self._known

    def place(self, buses: np.ndarray) -> None:
        """See :class:`Placed`."""
        buses = np.asarray(buses)[:, self._equipment.is_other]
        if self._known is None or len(np.unique(buses, axis=0)) > 1:
            self._commission(buses)

    def _commission(self, buses: np.ndarray) -> None:
        """Work out what agents know at each placement, (lane, n_agent); one lane where all are the same."""
        places, lane = np.unique(buses, axis=0, return_inverse=True)
        known = [commission(self._site, place) for place in places]
        which = lane.ravel() if len(places) > 1 else np.zeros(1, int)
        self._known = Commissioned(*(np.stack(field)[which] for field in zip(*known, strict=True)))

    def control(self, local: Local) -> tuple[np.ndarray, np.ndarray]:
        """See :class:`LocalController`; ValueError where buses are drawn and ``place`` was not called."""
        s, known = self.scenario, self._known
        if known is None:
            raise ValueError(
                f"model-aided: {s.name} draws the data centres' buses in each episode; call place(buses) after reset "
                "with the agents' positions in bus_ids, (lane, n_agent)"
            )
        lead = local.v_pu.shape[:-1]
        n_lane = int(np.prod(lead))
        flat = Local(*(field.reshape(n_lane, field.shape[-1]) for field in local))
        then_p, then_q = self._when_measured(flat)
        e_own = flat.v_pu - known.own_by_q * (then_q - known.origin_kvar)
        e_own = e_own + known.own_by_draw * (then_p - known.mean_kw)
        v, s_pu, by_all = estimate(self._site, known, e_own, then_p)
        v = v + known.by_q * (flat.q_kvar - known.origin_kvar)[..., None]
        f_mhz, p_next_kw, v = self._clocks(flat, v, s_pu)
        share, scale = flat.q_kvar / self._site.share_of_kvar, self._site.share_of_kvar
        rest = resting(self._site, known.rest_at, known.rest_kvar, p_next_kw) / scale
        share = best_response(
            self._price, v, s_pu, self.alike * by_all, known.by_q * self._q_scale[:, None], share,
            self._site.limit_share(p_next_kw), self._site.effort, self.hold, rest, _HALVINGS,
        )  # fmt: skip
        share = share + self.pull * self._site.scheduled * (rest - share)
        q_kvar = np.clip(share, -1.0, 1.0) * self._q_scale
        return f_mhz.reshape(*lead, f_mhz.shape[-1]), q_kvar.reshape(*lead, q_kvar.shape[-1])

    def _when_measured(self, local: Local) -> tuple[np.ndarray, np.ndarray]:
        """Own powers at the time that the measured voltage is of, kW and kvar."""
        self._past = [*self._past, (local.p_kw, local.q_kvar)][-(self.scenario.measurement_delay + 1) :]
        return self._past[0]

    def _clocks(self, local: Local, v: np.ndarray, s_pu: np.ndarray) -> tuple[np.ndarray, ...]:
        """Clocks, MHz, the draws that follow, kW, and the voltages then, p.u., from those at the mean draws."""
        s, known = self.scenario, self._known
        assert known is not None
        dc, n_dc, p_kw = s.datacenter, s.n_datacenters, local.p_kw.copy()
        if not n_dc:
            return local.p_ref_next_kw, p_kw, v - known.by_draw * (p_kw - known.mean_kw)[..., None]
        p_ref_kw = local.p_ref_next_kw
        if not s.preview:
            p_ref_kw = np.broadcast_to(np.maximum(known.mean_kw[:, :n_dc], dc.p_idle_kw), p_ref_kw.shape)
        idle_kw, arrives_kw = np.minimum(p_ref_kw, dc.p_idle_kw), np.maximum(p_ref_kw - dc.p_idle_kw, 0.0)
        ceiling_kw = np.maximum(dc.p_dynamic_kw, arrives_kw)
        all_kw = np.minimum(ceiling_kw, arrives_kw + local.backlog_kws / s.dt_s)
        p_kw[:, :n_dc] = idle_kw + all_kw
        v = v - known.by_draw * (p_kw - known.mean_kw)[..., None]
        by_p, by_draw = known.by_p[:, :n_dc], known.by_draw[:, :n_dc]
        waiting = self.price * (s.weights.backlog + s.weights.leftover) * s.dt_s / (dc.p_rated_kw.sum() or 1.0)

        def pays(served_kw: np.ndarray) -> np.ndarray:
            then = v[:, :n_dc] + by_draw * (all_kw - served_kw)[..., None]
            return -(self._price.slope(then, s_pu[:, :n_dc]) * by_p).sum(axis=-1) > waiting

        cut = pays(all_kw)
        low, high = np.minimum(ceiling_kw * s.f_min_mhz / s.f_max_mhz, all_kw), all_kw.copy()
        for _ in range(_HALVINGS if cut.any() else 0):
            middle = (low + high) / 2.0
            less = pays(middle)
            low, high = np.where(less, low, middle), np.where(less, middle, high)
        served_kw = np.where(cut, low, all_kw)
        v = np.concatenate((v[:, :n_dc] + by_draw * (all_kw - served_kw)[..., None], v[:, n_dc:]), axis=1)
        p_kw[:, :n_dc] = idle_kw + served_kw
        # Where all work is to be served the clock may as well be at its top.
        f_mhz = np.where(cut, served_kw / ceiling_kw * s.f_max_mhz, s.f_max_mhz)
        return np.clip(f_mhz, s.f_min_mhz, s.f_max_mhz), p_kw, v

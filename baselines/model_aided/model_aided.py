"""A local law from the feeder's model, without learning: each agent acts on what its own voltage says of all others.

At commissioning an agent is given the model of the feeder, the places and ratings of all agents and the statistics of
load, work and sun (``commissioning``). From then on it sees what every agent sees: its own voltage, powers, backlog and
coming work. Each second it

1. takes its own part out of its voltage, E_i = V_i - X_ii (q_i - u*_i) + D_ii (p_i - mean p_i), and where measurements
   have noise, averages that (``average``),
2. estimates every voltage of the coming second from that, with its error,
       V^_k = E[E_k | E_i] + X_ik (q_i - u*_i) - D_ik (p_next - mean p_i),
3. if it is a data centre, serves work while a kW less would relieve less expected cost than waiting costs. The relief
   is sum_k -c'(V^_k + D_ik y) R_ik with y kW put off. The price is that of MPC, (w_backlog + w_leftover) dt / sum
   p_rated, charged as if left at the end, and more if later moments are not better (``commissioning``),
4. sets its reactive power where its slope of the expected cost is zero if all move alike (``response_kernels``). An
   inverter that sees the sun is pulled towards the optimum of that level.

It knows more than a law of local measurements does and less than MPC, which sees all voltages: its scope is
``model-aided``. Under a delay of the measurement it takes the powers of that time; a hidden p_ref is taken at its mean.
Equipment that is an agent follows its own control. Cost terms other than voltage, backlog and effort have no effect.
The law minimises abs(V - 1) even if the scenario has another form or reference of the voltage cost.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import ClassVar, NamedTuple

import numpy as np

from dcgrid_env import Scenario
from dcgrid_env.baselines.controller import Local, LocalController
from dcgrid_env.baselines.model_aided.average import Average
from dcgrid_env.baselines.model_aided.commissioning import commission, site_of
from dcgrid_env.baselines.model_aided.decision import DecisionInputs, decide, own_error
from dcgrid_env.baselines.model_aided.knowledge import Commissioned, Law, Site, by_sun, resting
from dcgrid_env.devices import site_work


class _Work(NamedTuple):
    """Work of the coming second by site, kW, (row, n_dc)."""

    idle_kw: np.ndarray
    ceiling_kw: np.ndarray
    """What the top clock serves."""
    all_kw: np.ndarray
    """What is there, up to that."""
    least_kw: np.ndarray
    """What the lowest clock serves of it."""


@dataclass
class ModelAided(Law, LocalController):
    """The model-aided local law; its settings are those of :class:`Law`."""

    scope: ClassVar[str] = "model-aided"

    def reset(self, env_info: Scenario) -> None:
        """Begin new episodes; ValueError for devices, or sites that draw otherwise, than this law is made for."""
        super().reset(env_info)
        s = self.scenario
        self._site = site_of(s, Law(**asdict(self)))
        self._steps = 0
        self._known: Commissioned | None = None
        self._past: list[tuple[np.ndarray, np.ndarray]] = []
        self._average = Average()
        fixed = [device.buses for device in s.devices if device.count]
        self._drawn = any(buses is None for buses in fixed)
        if not self._drawn:
            buses = [s.feeder.index(bus) for buses in fixed for bus in buses or ()]
            self._known = commission(self._site, np.array([buses]))

    @property
    def site(self) -> Site:
        """What is the same in all placements, after ``reset``."""
        return self._site

    @property
    def known(self) -> Commissioned | None:
        """Data of the agents at their buses, stacked over rows; None before they are placed."""
        return self._known

    def place(self, buses: np.ndarray) -> None:
        """See :class:`NeedsPlacement`."""
        places, place_index = np.unique(np.asarray(buses)[:, self._equipment.is_other], axis=0, return_inverse=True)
        if self._known is None or self._drawn:
            known = commission(self._site, places)
            self._known = known if len(places) == 1 else known.take(place_index.ravel())

    def control(self, local: Local) -> tuple[np.ndarray, np.ndarray]:
        """See :class:`LocalController`; ValueError where buses are drawn and ``place`` was not called."""
        s, known, site = self.scenario, self._known, self._site
        if known is None:
            raise ValueError(
                f"model-aided: {s.name} draws the data centres' buses in each episode; call place(buses) after reset "
                "with the agents' positions in bus_ids, (row, n_agent)"
            )
        lead = local.v_pu.shape[:-1]
        n_row, n_dc = int(np.prod(lead)), s.datacenters.count
        flat = Local(*(field.reshape(n_row, field.shape[-1]) for field in local))
        work = self._work(flat, known)
        p_kw = flat.p_kw.copy()
        p_kw[:, :n_dc] = work.idle_kw + work.all_kw
        rest_kvar = resting(site, known, p_kw)
        then_kw, then_kvar = self._when_measured(flat)
        v_pu, kvar = flat.v_pu, flat.q_kvar
        # All begin without reactive power, and know it: they go on as if they stood at u*.
        if self._steps <= s.sensing.delay_steps:
            v_pu, then_kvar = v_pu + by_sun(site, known.start_pu, known.rest_at, then_kw), rest_kvar
        if self._steps == 0:
            kvar = rest_kvar
        self._steps += 1
        if s.sensing.noise_pu:
            e_own = own_error(known, v_pu, then_kw, then_kvar)
            v_pu = v_pu + self._average(known, e_own) - e_own
        inputs = DecisionInputs(v_pu, then_kw, then_kvar, kvar, p_kw, work.all_kw - work.least_kw, rest_kvar)
        best = decide(site, known, inputs)
        # Where all work is to be served the clock may as well be at its top.
        f_mhz = (
            np.where(best.cut_kw > 0.0, (work.all_kw - best.cut_kw) / work.ceiling_kw, 1.0) * s.datacenters.f_max_mhz
        )
        q_kvar = best.share * site.q_scale_kvar
        q_kvar = q_kvar + self.pull * site.scheduled * (rest_kvar - q_kvar)
        f_mhz = np.clip(f_mhz, s.datacenters.f_min_mhz, s.datacenters.f_max_mhz)
        return f_mhz.reshape(*lead, n_dc), q_kvar.reshape(*lead, q_kvar.shape[-1])

    def _when_measured(self, local: Local) -> tuple[np.ndarray, np.ndarray]:
        """Own powers at the time that the measured voltage is of, kW and kvar."""
        self._past = [*self._past, (local.p_kw, local.q_kvar)][-(self.scenario.sensing.delay_steps + 1) :]
        return self._past[0]

    def _work(self, local: Local, known: Commissioned) -> _Work:
        s, n_dc = self.scenario, self.scenario.datacenters.count
        dc, p_ref_kw = s.datacenters.parameters, local.p_ref_next_kw
        if not s.sensing.preview:
            p_ref_kw = np.broadcast_to(np.maximum(known.mean_kw[:, :n_dc], dc.p_idle_kw), p_ref_kw.shape)
        arriving_kw = site_work.arriving(dc.p_idle_kw, p_ref_kw)
        ceiling_kw = site_work.top_power(dc.p_dynamic_kw, arriving_kw)
        all_kw = np.minimum(ceiling_kw, site_work.at_hand(local.backlog_kws, arriving_kw, s.dt_s))
        least_kw = np.minimum(ceiling_kw * s.datacenters.f_min_mhz / s.datacenters.f_max_mhz, all_kw)
        return _Work(site_work.idle_draw(dc.p_idle_kw, p_ref_kw), ceiling_kw, all_kw, least_kw)

"""Model predictive control: each second the cost of the coming steps is minimised, and the first of them is done.

The program is that of ``lookahead``, the benchmark's own cost over ``horizon`` steps; the model is ``model``'s, which
begins from the measured voltages. p_ref of the next step is observed. Of those beyond it, and of the next one too where
the scenario hides it, the forecast is

    p_ref(t + k) = mean + exp(-(k - 1) dt / tau) (p_ref(t + 1) - mean)

with the mean of what the site has drawn so far; an infinite tau is persistence. Other loads and the inverters' active
power are assumed constant, like an inverter's reactive limit, and an agent whose limit is zero is left out. Waiting
work at the end of the horizon is charged like leftover work at the end of an episode. Otherwise a short horizon would
always defer work. With a horizon of one step it is one-step control, which knows all that it needs if p_ref is
observed. (J. B. Rawlings, D. Q. Mayne, M. Diehl, "Model predictive control: theory, computation, and design", 2017.)

Where built-in controls move regulators and nothing trips, ``tap_plan`` adds demands on their relays to the first step.
It requires taps, relay volts and timers, which ``measure`` receives before each step.

The price of what is left does most of it. J on the validation split of ieee33-weak (hindsight 2.674), 20 episodes, and
10 under two other loads; 14 s is when the default load's autocorrelation has fallen to some 0.3:

    horizon           1       5       8       12      20      20, persistence
    "inference"       2.682   2.686   2.685   2.686   2.686   2.694
    "code"            3.214   3.206   3.211   3.199   3.204   3.213
    "training"        6.738   6.889   6.869   6.695   6.633   6.697
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from dcgrid_env import RegulatorState, Scenario, acting_relays, cost_prices, voltage_targets
from dcgrid_env.baselines.model_based.linear_model import Estimate, ModelController
from dcgrid_env.baselines.model_based.lookahead import Iterate, Program, moved_on, restarted, solve
from dcgrid_env.baselines.model_based.relay_model import relay_model
from dcgrid_env.baselines.model_based.tap_plan import Demands, Outlook, TapPlan
from dcgrid_env.devices import converter, may_leave, site_work

_SETTLED = 1e-3  # share of a site's dynamic power by which the solver's work served may fall short of all there is


@dataclass
class Mpc(ModelController):
    """Model predictive control.

    Parameters
    ----------
    horizon
        Steps to look ahead.
    forecast_s
        Time in which p_ref is taken to go back to its mean (tau above), s; infinite for a p_ref that stays.
    rounds
        Rounds of the solver in each step, from where it stood in the last.
    """

    horizon: int = 12
    forecast_s: float = 14.0
    rounds: int = 100

    name: ClassVar[str] = "mpc"

    def __post_init__(self) -> None:
        for field in ("horizon", "rounds"):
            value = getattr(self, field)
            if not (isinstance(value, int) and value >= 1):
                raise ValueError(f"{self.name}: {field} is {value!r}; give a whole number >= 1")
        if not self.forecast_s > 0.0:
            raise ValueError(f"{self.name}: forecast_s is {self.forecast_s!r}; give a time > 0, infinite to persist")

    def reset(self, env_info: Scenario) -> None:
        """See :class:`ModelController`."""
        super().reset(env_info)
        s, prices, dc = self.scenario, cost_prices(self.scenario), self.scenario.datacenters.parameters
        # Powers are shares of these in the program.
        self._size = np.concatenate((dc.p_dynamic_kw, s.inverters.parameters.s_rated_kva))
        price = np.full((self.horizon, 1), prices.backlog)
        price[-1] += prices.leftover
        self._price = price * dc.p_dynamic_kw * s.dt_s
        self._effort = prices.effort * self._size
        is_nominal = s.cost.reference == "nominal"
        self._target_pu = None if is_nominal else voltage_targets(s)[s.feeder.load_slice] - 1.0
        self._solution: Iterate | None = None
        self._drawn_kw: np.ndarray | float = 0.0
        self._drawn_steps = 0
        if s.grid_control.regulator_settings.has_schedules:
            raise ValueError(
                f"{self.name} plans taps under constant set points; scenario {s.name!r} has a schedule in "
                "grid_control.regulator_settings.offset_v: give it numbers"
            )
        # The plan of taps assumes that sites and inverters stay on the grid. Where they trip, it does harm.
        self._relays = None if any(map(may_leave, s.devices)) else acting_relays(env_info)
        self._regulators: RegulatorState | None = None
        self._steps_left = s.horizon
        self._taps = None if self._fixed_buses is None else self._tap_plan(self._fixed_buses)

    def place(self, buses: np.ndarray) -> None:
        """See :class:`NeedsPlacement`."""
        super().place(buses)
        self._taps = self._tap_plan(np.asarray(buses)[:, self._equipment.is_other])

    def measure(self, regulators: RegulatorState) -> None:
        """See :class:`NeedsRegulators`."""
        self._regulators = regulators

    def _tap_plan(self, buses: np.ndarray) -> TapPlan | None:
        """The plan of taps where built-in controls act within steps, for agents at these positions of ``bus_ids``."""
        if self._relays is None:
            return None
        if (buses == buses[:1]).all():
            buses = buses[:1]
        is_integrating = self.scenario.grid_control.regulator_settings.timer == "integrating"
        # Controlled capacitor banks share the mean of moves, so with them a tap costs at most this.
        price = self.scenario.cost.weights.switching / len(self._relays.rows)
        return TapPlan(relay_model(self.scenario, self._relays, buses), self.scenario.dt_s, is_integrating, price)

    def plan(self, now: Estimate) -> tuple[np.ndarray, np.ndarray]:
        """See :class:`ModelController`."""
        s, dc, n_dc = self.scenario, self.scenario.datacenters.parameters, self.scenario.datacenters.count
        p_ref_kw = self._forecast(now)
        program = self._program(now, p_ref_kw)
        if self._taps is not None:
            program = self._with_taps(program, self._taps, now, p_ref_kw[:, 0])
        start = None if self._solution is None else restarted(program, moved_on(self._solution))
        self._solution = solve(program, start, self.rounds)
        first = self._solution.y[:, 0]
        if self._taps is not None:
            self._taps.expect(first[:, n_dc:] * self._size)
        ceiling = np.maximum(1.0, (p_ref_kw[:, 0] - dc.p_idle_kw) / self._size[:n_dc])
        # Where all work is to be served the clock may as well be at its top: more may come than was forecast.
        served = first[:, :n_dc]
        share = np.where(served >= program.work[:, 0] - _SETTLED, 1.0, served / ceiling)
        return np.clip(share * s.datacenters.f_max_mhz, s.datacenters.f_min_mhz, s.datacenters.f_max_mhz), first[
            :, n_dc:
        ] * self._size

    def _with_taps(self, program: Program, plan: TapPlan, now: Estimate, p_ref_kw: np.ndarray) -> Program:
        """The program with the taps of the coming step, and the demands on relays there; work does not wait."""
        if self._regulators is None:
            raise ValueError(
                f"{self.name}: the regulators were not measured; call measure(regulators) with a RegulatorState "
                "before each act"
            )
        local, n_dc, n_row = now.local, self.scenario.datacenters.count, len(p_ref_kw)
        size, size_kvar = self._size[:n_dc], self._size[:, None]
        measured_v = self._regulators.relay_v[:, plan.model.relays.rows]
        without_q_v = measured_v - np.matmul(local.q_kvar[:, None], plan.model.by_q)[:, 0]
        outlooks = []
        for drawn_kw in (self._drawn_kw / self._drawn_steps, np.minimum(p_ref_kw, program.s_rated[:, 0] * size)):
            served = np.maximum(drawn_kw / size - program.base[:, 0], 0.0)
            change_kw = (program.base[:, 0] + served) * size - local.p_kw[:, :n_dc]
            deviation_pu = program.offset[:, 0] + np.matmul(served[:, None], program.slopes[:, :n_dc])[:, 0]
            relay_v = without_q_v + np.matmul(change_kw[:, None], plan.model.by_p[:, :n_dc])[:, 0]
            outlooks.append(Outlook(deviation_pu, relay_v))
        usual, next_step = outlooks
        of_sites = converter.limit(program.s_rated[:, 0], program.q_high[:, :n_dc], program.base[:, 0] + served)
        q_high = np.concatenate((of_sites, program.q_high[:, n_dc:]), axis=1)
        by_q = plan.model.by_q * size_kvar
        reactive = plan.limited(program._replace(slopes=program.slopes[:, n_dc:], q_high=q_high), by_q)
        choice = plan.choose(reactive, usual, next_step, self._regulators, self._steps_left)
        self._regulators, self._steps_left = None, max(self._steps_left - 1, 1)
        anything = np.full((n_row, self.horizon - 1, choice.taps.shape[-1]), np.inf)
        low, high = (side[:, None] for side in choice.demands)
        demands = Demands(np.concatenate((low, -anything), axis=1), np.concatenate((high, anything), axis=1))
        moved_pu = program.offset + (choice.taps @ plan.model.v_by_tap)[:, None]
        limited = plan.limited(program, np.concatenate((0.0 * plan.model.by_p[:, :n_dc], by_q), axis=1))
        return limited._replace(offset=plan.offset(moved_pu, next_step.relay_v[:, None], demands))

    def _forecast(self, now: Estimate) -> np.ndarray:
        """p_ref of the steps ahead, kW, (row, step, n_dc)."""
        s, next_kw = self.scenario, now.p_ref_kw
        self._drawn_kw, self._drawn_steps = self._drawn_kw + now.p_ref_kw, self._drawn_steps + 1
        total_kw, count = self._drawn_kw, self._drawn_steps
        if s.sensing.preview:
            next_kw = now.local.p_ref_next_kw
            total_kw, count = total_kw + next_kw, count + 1
        mean_kw = total_kw / count
        ahead_s = s.dt_s * (np.arange(self.horizon) + (0 if s.sensing.preview else 1))
        return mean_kw[:, None] + np.exp(-ahead_s / self.forecast_s)[:, None] * (next_kw - mean_kw)[:, None]

    def _program(self, now: Estimate, p_ref_kw: np.ndarray) -> Program:
        s, local = self.scenario, now.local
        prices, dc, n_dc = cost_prices(s), s.datacenters.parameters, s.datacenters.count
        base_kw = site_work.idle_draw(dc.p_idle_kw, p_ref_kw)
        arrives_kw = site_work.arriving(dc.p_idle_kw, p_ref_kw)
        waits_kw = local.backlog_kws / s.dt_s
        at_hand_kw = arrives_kw.copy()  # at the least: what waits is counted in the first step alone
        at_hand_kw[:, 0] += waits_kw
        ceiling_kw = site_work.top_power(dc.p_dynamic_kw, arrives_kw)
        high_kw = ceiling_kw.copy()
        high_kw[:, 0] = np.minimum(high_kw[:, 0], at_hand_kw[:, 0])
        by_p, size = now.by_p[:, :n_dc], self._size[:n_dc]
        idle_pu = np.matmul(base_kw - local.p_kw[:, None, :n_dc], by_p) - np.matmul(local.q_kvar[:, None], now.by_q)
        return Program(
            offset=now.v_pu[:, None] - 1.0 + idle_pu,
            slopes=np.concatenate((by_p * size[:, None], now.by_q * self._size[:, None]), axis=1),
            base=base_kw / size,
            low=np.minimum(ceiling_kw * (s.datacenters.f_min_mhz / s.datacenters.f_max_mhz), at_hand_kw) / size,
            high=high_kw / size,
            # Above its rating, where a boost may take it, a converter gives no reactive power, and the clock may stay.
            s_rated=np.maximum(self._rated_kva[:n_dc], base_kw + high_kw) / size,
            q_high=self._limit_kvar(now) / self._size,
            work=(waits_kw[:, None] + np.cumsum(arrives_kw, axis=1)) / size,
            price=self._price,
            voltage=prices.voltage,
            violation=prices.violation,
            effort=self._effort,
            band_pu=s.cost.band_pu,
            target=self._target_pu,
            uncharged_pu=s.cost.uncharged_pu,
        )

    def _limit_kvar(self, now: Estimate) -> np.ndarray:
        """Reactive limit apart from the sites' circle, kvar, (row, n_agent): an inverter's as observed, a site's own.

        A site without one though its draw leaves room is out of order.
        """
        n_dc = self.scenario.datacenters.count
        limit = now.q_limit_kvar.copy()
        out = (limit[:, :n_dc] <= 0.0) & (now.local.p_kw[:, :n_dc] < 0.99 * self._rated_kva[:n_dc])
        limit[:, :n_dc] = np.where(out, 0.0, self._q_scale[:n_dc])
        return limit

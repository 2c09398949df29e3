"""The linear program of an episode: the least cost that served work and reactive power can have, knowing all of it.

On the power flow linearised around a trajectory:

    minimise  (1/T) sum_t c_t + leftover        the benchmark's cost, see ``dcgrid_env.engine.cost.reward``
    over      d, b   served work and backlog of each data centre        b_t = b_{t-1} + (a_t - d_t) dt,  b >= 0
              q, g   reactive injection of each agent and its magnitude, within the limit
              e, w   deviation of each bus's voltage, and its excess over the band
    with      |v_t + J_p (d_t - d0_t) + J_q (q_t - q0_t) - 1| <= e_t,  w_t >= e_t - band,
                  (where the cost has a voltage profile: e_t is what goes beyond the band around it)
              cos(theta) p + sin(theta) g <= s_rated     for tangents theta of the capability circle

so nothing is served before it arrives, and what is left at the end is charged as the environment charges it. Storages
add the unknowns and rows of ``storage_rows``; their draws follow the served work in d. Work that may be moved, or
has a time to be served by, adds those of ``work_rows``, and requests of a utility those of ``request_rows``.
``voltage_rows`` leaves out the e and w that are not needed. Where built-in controls move the regulators, demands on
relay volts lead them along a ``TapTrajectory``; z is the deviation from a demand. Solved with HiGHS (Q. Huangfu and
J. A. J. Hall, "Parallelizing the dual revised simplex method", Mathematical Programming Computation 10, 2018).
"""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy import sparse
from scipy.optimize import linprog

from dcgrid_env import Forecast, Scenario, acting_relays, voltage_targets
from dcgrid_env.baselines.model_based.request_rows import RequestRows
from dcgrid_env.baselines.model_based.storage_rows import StorageRows
from dcgrid_env.baselines.model_based.tap_trajectory import Demands, TapTrajectory
from dcgrid_env.baselines.model_based.trajectory import HindsightError, Trajectory
from dcgrid_env.baselines.model_based.voltage_rows import voltage_rows

Sparse = Any  # scipy's sparse matrices and arrays of every layout
Limits = list[tuple[Sparse, np.ndarray]]  # rows of the program and what each is at most

TANGENTS = 24
"""Tangents of a quadrant of the capability circle."""
OFF_DEMAND = 1.0
"""Share of J that a volt off a relay's demand costs in one step; a tap is some 0.1 of J, and 0.75 V."""
ANGLES = 0.5 * np.pi * np.arange(1, TANGENTS) / TANGENTS
"""Their angles."""


class EpisodeProgram(Trajectory):
    """The linear program of an episode, around the trajectory of its last solution.

    Unknowns, each (T, ...) and flattened: d (n_dc, then storages), b (n_dc), q, g (n_agent), e, w (buses but the
    substation), z (relays); behind them those of ``storage_rows``, ``work_rows`` and ``request_rows``.
    """

    def __init__(self, scenario: Scenario, episode: Forecast, keep_band: bool, leads_relays: bool = False) -> None:
        super().__init__(scenario, episode)
        s, n_dc, self.keep_band = scenario, scenario.datacenters.count, keep_band
        n_bus, self.storage_rows = len(s.feeder.load_nodes), StorageRows(s, episode.available)
        widths = {"d": n_dc + self.n_storages, "b": n_dc, "q": s.n_agents, "g": s.n_agents, "e": n_bus, "w": n_bus}
        self.sizes = {name: s.horizon * width for name, width in widths.items()}
        self.relays = acting_relays(s) if leads_relays else None
        self.demands: Demands | None = None
        """Volts that the relays have to measure; see ``lead``."""
        self.tap_price = 0.0 if self.relays is None else s.cost.weights.switching / len(self.relays.rows) / s.horizon
        """Share of J that each tap costs."""
        self.sizes["z"] = 0 if self.relays is None else s.horizon * len(self.relays.rows)
        self.request_rows = RequestRows(s, episode, self.base_kw)
        self.sizes |= self.storage_rows.sizes | self.work_rows.sizes | self.request_rows.sizes
        of_storages = [(self._rows(**parts), most) for parts, most in self.storage_rows.limits(ANGLES)]
        in_d = self._in_d(0, n_dc)
        of_work = [(self._rows(**parts), most) for parts, most in self.work_rows.limits(in_d)]
        of_requests = [(self._rows(**parts), most) for parts, most in self.request_rows.limits(in_d)]
        self.same = [self._magnitude(1.0), self._magnitude(-1.0), *self._capability()]
        self.same += [*of_storages, *of_work, *of_requests]

    def solve(self) -> tuple[float, np.ndarray]:
        """Optimum and the actions (T, n_action) behind it; the next program is around them."""
        s, self._before = self.scenario, self._done
        solution, ranges = self.flows(), self._ranges(inf_w=not self.keep_band)
        d, q = (rows.reshape(s.horizon, -1, 2) for rows in (self._part(ranges, "d"), self._part(ranges, "q")))
        targets = None if s.cost.reference == "nominal" else voltage_targets(s)[s.feeder.load_slice]
        v_pu = self.linear(solution.v_pu[..., s.feeder.load_slice])
        voltages = voltage_rows(v_pu, d, q, s.cost.band_pu, targets, s.cost.uncharged_pu)
        limits = [(self._rows(**parts), most) for parts, most in (*voltages.limits, *self._led(solution))]
        prices = self._prices()
        price = self._part(prices, "e")[0]
        self._part(prices, "d")[:] += price * voltages.by_d
        self._part(prices, "q")[:] += price * voltages.by_q
        limits += self.same
        result = self._optimum(limits, prices, ranges)
        if result.status != 0:
            raise HindsightError(f"hindsight of scenario {s.name!r} has no solution: {self._unmet(limits, result)}")
        d, q = (self._part(result.x, name).reshape(s.horizon, -1) for name in "dq")
        received, sent = (self._part(result.x, name) for name in "yo")
        moved = (received - sent).reshape(s.horizon, -1) if len(received) else self.moved_kw
        self._solution = self._done = (d[:, : s.datacenters.count], d[:, s.datacenters.count :], q, moved)
        moves = np.abs(np.diff(self.taps, axis=0)).sum() if self.tap_price else 0.0
        return float(result.fun + price * voltages.at_zero + self.tap_price * moves), self.actions()

    def go(self, share: float) -> np.ndarray:
        """Go a share of the way to the last solution from the trajectory that it is around; the actions of that.

        All constraints are linear, so that they hold all along it.
        """
        if share < 1.0:
            ways = zip(self._before, self._solution, strict=True)
            self._done = tuple(old + share * (new - old) for old, new in ways)
        else:
            self._done = self._solution
        return self.actions()

    def _optimum(self, limits: Limits, prices: np.ndarray, ranges: np.ndarray) -> Any:
        rows, bounds = zip(*limits, strict=True)
        conserved, amount = self._conservation()
        return linprog(
            prices,
            A_ub=sparse.vstack(rows, format="csr"),
            b_ub=np.concatenate(bounds),
            A_eq=conserved,
            b_eq=amount,
            bounds=ranges,
            method="highs-ds",
        )

    def _part(self, values: np.ndarray, name: str) -> np.ndarray:
        """The rows of an array over all unknowns that are those of one, as a view."""
        ends = dict(zip(self.sizes, np.cumsum(list(self.sizes.values())), strict=True))
        return values[ends[name] - self.sizes[name] : ends[name]]

    def _unmet(self, limits: Limits, result: Any) -> str:
        """Which constraint cannot be met and when: only the band can be asked for in vain."""
        if not self.keep_band:
            return result.message
        excess_only = np.concatenate([np.full(size, float(name == "w")) for name, size in self.sizes.items()])
        least = self._optimum(limits, excess_only, self._ranges(inf_w=True)).x
        excess = self._part(least, "w").reshape(self.scenario.horizon, -1)
        feeder = self.scenario.feeder
        step, bus = np.unravel_index(np.argmax(excess), excess.shape)
        return (
            f"keep_band cannot be met; at bus {feeder.node_ids[feeder.load_nodes[bus]]} the voltage is at least "
            f"{excess[step, bus]:.4f} p.u. beyond the band at step {step + 1}; allow it (keep_band=False) or lighten "
            "the load"
        )

    @property
    def _done(self) -> tuple[np.ndarray, ...]:
        """Contents of the trajectory: work served, draws of storages, reactive power and work moved."""
        return self.served_kw, self.storage_kw, self.q_kvar, self.moved_kw

    @_done.setter
    def _done(self, done: tuple[np.ndarray, ...]) -> None:
        self.served_kw, self.storage_kw, self.q_kvar, self.moved_kw = done

    def _led(self, solution: Any) -> list[tuple[dict[str, Any], np.ndarray]]:
        """The rows that make the relays follow the trajectory of ``lead``."""
        if self.relays is None or self.demands is None:
            return []
        return list(self.demands.limits(self.linear(self.relays.volts(solution))))

    def lead(self, trajectory: TapTrajectory) -> None:
        """Go around the taps of a trajectory, and make the relays follow it."""
        assert self.relays is not None
        self._tap[:, self.relays.rows] = trajectory.tap[1:]
        volts = self.relays.volts(self.flows_at(np.stack((self.taps[:-1], self.taps[1:]))))
        before, after = volts.reshape(2, self.scenario.horizon, -1)
        self.demands = trajectory.demands(self.relays, after - before)

    def _prices(self) -> np.ndarray:
        """What each unknown costs, as shares of J."""
        s, w = self.scenario, self.scenario.cost.weights
        rated_kw = s.datacenters.parameters.p_rated_kw.sum() or 1.0
        backlog = np.full((s.horizon, s.datacenters.count), w.backlog / rated_kw)
        backlog[-1] += w.leftover / rated_kw
        effort = np.tile(w.effort / s.n_agents / self.s_rated_kva, s.horizon)
        n_bus = len(s.feeder.load_nodes)
        prices = {"b": backlog.ravel(), "g": effort, "e": w.voltage / n_bus, "w": w.violation / n_bus}
        prices |= {"z": OFF_DEMAND * s.horizon, **self.storage_rows.prices(), **self.work_rows.prices()}
        prices |= self.request_rows.prices()
        return (
            np.concatenate([np.broadcast_to(prices.get(name, 0.0), size) for name, size in self.sizes.items()])
            / s.horizon
        )

    def _ranges(self, inf_w: bool) -> np.ndarray:
        """Least and largest value of each unknown, (n, 2)."""
        # What arrives above the rating may be served at once, as in the environment.
        dc = self.scenario.datacenters.parameters
        top_kw = np.maximum(dc.p_dynamic_kw, self.arrived_kw)
        # At its lowest clock a site serves this much of what arrives. It serves as much of a backlog too, which no
        # linear constraint says: there the program may do less than the environment.
        stays_kw = self.arrived_kw - self.work_rows.movable_kw
        least_kw = np.minimum(top_kw * (dc.f_min_mhz / dc.f_max_mhz), stays_kw)
        q_kvar, inf = self.q_limit_kvar.ravel(), np.inf
        d = (
            np.concatenate(both, axis=1).ravel()
            for both in zip((least_kw, top_kw), self.storage_rows.draws(), strict=True)
        )
        ranges = {
            "d": tuple(d),
            "b": (0.0, inf),
            "q": (-q_kvar, q_kvar),
            "w": (0.0, inf if inf_w else 0.0),
            **self.storage_rows.ranges(),
            **self.work_rows.ranges(),
        }
        sides = [ranges.get(name, (0.0, inf)) for name in self.sizes]
        return np.concatenate(
            [
                np.stack([np.broadcast_to(side, size) for side in pair], axis=1)
                for pair, size in zip(sides, self.sizes.values(), strict=True)
            ]
        )

    def _conservation(self) -> tuple[Sparse, np.ndarray]:
        """b_t - b_{t-1} + d_t dt = a_t dt with what is moved, and the rows of ``storage_rows`` and ``work_rows``."""
        n, dt_s, n_dc = self.sizes["b"], self.scenario.dt_s, self.scenario.datacenters.count
        step = sparse.identity(n, format="csr") - sparse.eye(n, k=-n_dc, format="csr")
        queue = {"d": dt_s * self._in_d(0, n_dc), "b": step, **self.work_rows.moved()}
        parts = [(queue, self.arrived_kw.ravel() * dt_s), *self.work_rows.equalities()]
        parts += self.storage_rows.equalities(self._in_d(n_dc, self.n_storages))
        rows, amounts = zip(*((self._rows(**blocks), amount) for blocks, amount in parts), strict=True)
        return sparse.vstack(rows, format="csr"), np.concatenate(amounts)

    def _in_d(self, first: int, count: int) -> Sparse:
        """What picks so many unknowns d of each step, from the first on."""
        width = self.scenario.datacenters.count + self.n_storages
        return sparse.kron(sparse.identity(self.scenario.horizon), sparse.eye(count, width, k=first), format="csr")

    def _magnitude(self, sign: float) -> tuple[Sparse, np.ndarray]:
        """sign q - g <= 0."""
        one = sparse.identity(self.sizes["q"], format="csr")
        return self._rows(q=sign * one, g=-one), np.zeros(self.sizes["q"])

    def _capability(self) -> Limits:
        """cos(theta) (base + d) + sin(theta) g <= s_rated of the data centres, for each tangent of a quadrant.

        Above its rating, where a boost may take it, a converter gives no reactive power, which no linear constraint
        says: there the circle is as large as the draw.
        """
        s, n_dc = self.scenario, self.scenario.datacenters.count
        most_kw = self.base_kw + np.maximum(s.datacenters.parameters.p_dynamic_kw, self.arrived_kw)
        s_rated_kva = np.maximum(self.s_rated_kva[:n_dc], most_kw)
        one = self._in_d(0, n_dc)
        theirs = sparse.kron(sparse.identity(s.horizon), sparse.eye(n_dc, s.n_agents), format="csr")
        limits = []
        for theta in ANGLES:
            room = s_rated_kva - np.cos(theta) * self.base_kw
            limits.append((self._rows(d=np.cos(theta) * one, g=np.sin(theta) * theirs), room.ravel()))
        return limits

    def _rows(self, **parts: Sparse) -> Sparse:
        """Rows with these parts at their unknowns and nothing elsewhere."""
        n = next(iter(parts.values())).shape[0]
        columns = [parts.get(name, sparse.csr_matrix((n, size))) for name, size in self.sizes.items()]
        return sparse.hstack(columns, format="csr")

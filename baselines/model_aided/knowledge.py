"""What an agent knows from its commissioning: of the scenario, whatever the placement, and of a placement."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import NamedTuple

import numpy as np

from dcgrid_env import Scenario, cost_prices
from dcgrid_env.baselines.model_aided.operating_points import OperatingPoints
from dcgrid_env.baselines.parameter_checks import require_non_negative
from dcgrid_env.devices import converter


@dataclass
class Law:
    """Settings of the law.

    Parameters
    ----------
    floor_pu
        Least standard deviation of an estimated voltage, p.u.: the model's error.
    alike
        Share of all limits that an agent takes to move as it moves, where commissioning begins to look for the best.
    hold
        Price of being a whole limit away from the static optimum, as a share of what that limit costs or saves where
        all voltages are on the same side. Nothing where the scenario says that its model is not exact.
    pull
        Share of the way to the optimum of its level of the sun that an inverter with a schedule goes at each step.
    price
        Price of letting work wait, as a share of what MPC charges.
    rounds
        Rounds of the others' reactions in what commissioning takes for the statistics.

    Raises
    ------
    ValueError
        Naming the setting, for one that is negative or not finite, or a ``floor_pu`` of 0.
    """

    floor_pu: float = 0.0003
    alike: float = 0.8
    hold: float = 0.06
    pull: float = 0.3
    price: float = 1.0
    rounds: int = 6

    def __post_init__(self) -> None:
        require_non_negative("model-aided", **{field.name: getattr(self, field.name) for field in fields(Law)})
        if self.floor_pu == 0.0:
            raise ValueError("model-aided: floor_pu is 0; give a standard deviation > 0")


class Site(NamedTuple):
    """What is the same in all placements of a scenario."""

    scenario: Scenario
    points: OperatingPoints
    law: Law

    @property
    def scheduled(self) -> np.ndarray:
        """Which agents read the sun from their own injection, bool, (n,)."""
        agent = np.arange(self.scenario.n_agents)
        return (agent >= self.scenario.datacenters.count) & (self.scenario.schedule is not None)

    @property
    def q_scale_kvar(self) -> np.ndarray:
        """Reactive limit at zero active power, (n,)."""
        return self.scenario.q_scale_kvar

    @property
    def s_rated_kva(self) -> np.ndarray:
        """Ratings of the converters, (n,)."""
        return np.concatenate([device.converter_kva for device in self.scenario.devices])

    @property
    def kvar_share(self) -> np.ndarray:
        """The reactive limit, 1 where there is none, (n,)."""
        return np.where(self.q_scale_kvar > 0.0, self.q_scale_kvar, 1.0)

    @property
    def effort(self) -> np.ndarray:
        """Price of a whole limit of reactive power, (n,)."""
        return cost_prices(self.scenario).effort * self.q_scale_kvar

    @property
    def waiting(self) -> float:
        """Price of letting a kW of work wait, that of MPC: charged as if it were left at the end."""
        prices = cost_prices(self.scenario)
        return self.law.price * (prices.backlog + prices.leftover) * self.scenario.dt_s

    @property
    def never(self) -> float:
        """Price of a kW that is not served to the end, in the mean over the steps that it may be put off at."""
        s, prices = self.scenario, cost_prices(self.scenario)
        return (prices.backlog * s.horizon / 2.0 + prices.leftover) * s.dt_s

    def limit_kvar(self, p_kw: np.ndarray) -> np.ndarray:
        """Reactive limit at a draw, of the draw's shape (.., n)."""
        return converter.limit(self.s_rated_kva, self.q_scale_kvar, p_kw)


class Commissioned(NamedTuple):
    """Data that agents have of m placements: n agents, L levels, k nodes without the source.

    ``known.take(rows)`` has one a row, where rows are at different placements; one alone serves all rows.
    """

    mean_kw: np.ndarray
    """Mean draw, (m, n)."""
    rest_kvar: np.ndarray
    """u* at each level of the sun, (m, L, n); one level without a schedule."""
    rest_at: np.ndarray
    """Mean of these levels, draw of an inverter as a share of its rating (negative), rising, (m, L)."""
    start_pu: np.ndarray
    """Rise of the own voltage when all go from no reactive power to u*, at each level, (m, L, n)."""
    origin_kvar: np.ndarray
    """The setpoint that deviations are counted from, (m, n)."""
    by_q: np.ndarray
    """X: rise of each voltage by own injection, p.u. per kvar, (m, n, k)."""
    by_own: np.ndarray
    """Rise of each voltage by own injection once the others have answered it, p.u. per kvar, (m, n, k)."""
    by_p: np.ndarray
    """R: drop of each voltage by own draw, p.u. per kW, (m, n, k)."""
    by_draw: np.ndarray
    """D: drop that comes with each kW drawn, p.u. per kW, (m, n, k)."""
    own_by_q: np.ndarray
    """X at the own bus, (m, n)."""
    own_by_draw: np.ndarray
    """D at the own bus, (m, n)."""
    key: np.ndarray
    """Key of each level: own draw of an inverter under a schedule, kW, else E_i, p.u., rising, (m, n, L)."""
    base_pu: np.ndarray
    """Mean of E_k, (m, n, L, k)."""
    own_base_pu: np.ndarray
    """Mean of E_i, (m, n, L)."""
    gain: np.ndarray
    """g, (m, n, L, k)."""
    inverse_spread: np.ndarray
    """1 / s, (m, n, L, k)."""
    by_all: np.ndarray
    """Rise of each voltage when all agents inject their whole limit more, p.u., (m, n, L, k)."""
    hold: np.ndarray
    """Price of being a whole limit away from u*, in units of the cost, (m, n)."""
    newest: np.ndarray
    """K: share of its way that a measurement moves the average of E, 1 without noise, (m, n)."""
    alike: np.ndarray
    """Share of all limits that an agent takes to move as it moves, (m, n)."""
    waiting: np.ndarray
    """Price of letting a kW of work wait, (m, n_dc)."""

    def take(self, rows: np.ndarray) -> Commissioned:
        """The placement of each row, by its position here."""
        return Commissioned(*(field[rows] for field in self))


def resting(site: Site, known: Commissioned, p_kw: np.ndarray) -> np.ndarray:
    """u* as an agent has it at its draw, kvar, (row, n)."""
    return by_sun(site, known.rest_kvar, known.rest_at, p_kw)


def by_sun(site: Site, values: np.ndarray, knots: np.ndarray, p_kw: np.ndarray) -> np.ndarray:
    """Interpolate figures of the levels of the sun to what an inverter reads off its draw; others have the mean.

    Parameters
    ----------
    site
        Knowledge of the placement, which contains the agents that see the sun.
    values, at
        Figures by level, such as ``Commissioned.rest_kvar``, (m, L, n), and ``rest_at``, (m, L); m is 1, or the rows.
    p_kw
        Draws, (row, n).
    """
    per_row = np.broadcast_to(values, (len(p_kw), *values.shape[1:]))
    knots = np.broadcast_to(knots, (len(p_kw), knots.shape[1]))
    out = per_row.mean(axis=1)
    kva, rows = site.scenario.scheduled_kva, np.arange(len(p_kw))
    for j in np.flatnonzero(site.scheduled):
        share = p_kw[:, j] / (kva[j - site.scenario.datacenters.count] or 1.0)
        low, weight = between(share[:, None], knots[:, None])
        a, b = (per_row[rows, low[:, 0] + more, j] for more in (0, 1))
        out[:, j] = a + weight[:, 0] * (b - a)
    return out


def between(value: np.ndarray, knots: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The knot below a value, and how far it is on the way to the next, 0 to 1, held at the ends; knots (.., L)."""
    n = knots.shape[-1]
    if n == 1:
        return np.zeros(value.shape, int), np.zeros(value.shape)
    low = (value[..., None] >= knots[..., 1:-1]).sum(axis=-1)
    wide = np.broadcast_to(knots, (*value.shape, n))
    a, b = (np.take_along_axis(wide, (low + more)[..., None], -1)[..., 0] for more in (0, 1))
    return low, np.clip((value - a) / np.maximum(b - a, 1e-12), 0.0, 1.0)

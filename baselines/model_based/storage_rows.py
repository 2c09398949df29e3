"""What storages add to the linear program of an episode.

    over      c, x   charge and discharge at the grid, kW, of each storage        draw u = c - x
              s      stored energy, kWh
              m      energy that is missing at the end, kWh
    with      s_t = k s_{t-1} + (eta_c c_t - x_t / eta_d) h,  0 <= s <= energy      k: what stand-by leaves in a step
              m >= returned - s_T,
              cos(theta) (c + x) + sin(theta) g <= s_rated     for tangents theta of the capability circle

Charge and discharge are apart, so that what each loses is linear. Nothing forbids both at once, which no storage can:
that burns energy, pays for throughput twice, and helps only where more is to be drawn than there is room for. There the
program is a relaxation, and its optimum a bound all the same.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy import sparse

from dcgrid_env import Scenario

Part = tuple[dict[str, Any], np.ndarray]  # parts of rows by their unknowns, and what each row is, or is at most


class StorageRows:
    """The storages of a scenario in the program of an episode; nothing at all where it has none.

    Parameters
    ----------
    scenario
        With its storages behind all other agents.
    available
        1 for an agent that is connected to the grid and 0 for one that is not, (T, n_agent).
    """

    def __init__(self, scenario: Scenario, available: np.ndarray) -> None:
        group = storages_of(scenario)
        self.count = n = 0 if group is None else group.count
        self.steps, self.n_agents = scenario.horizon, available.shape[1]
        self.sizes = {"c": self.steps * n, "x": self.steps * n, "s": self.steps * n, "m": n}
        """Number of unknowns of each name."""
        if group is None:
            return
        self.params, self.hours = group.parameters, scenario.dt_s / 3600.0
        self.q_limit_kvar, self.s_rated_kva = group.q_limit_kvar, group.converter_kva
        self.kept = (1.0 - self.params.standby_share_per_h) ** self.hours
        self.most_kw = self.params.p_rated_kw * available[:, self.n_agents - n :]

    def draws(self) -> tuple[np.ndarray, np.ndarray]:
        """Least and largest draw in each step, kW, (T, n) each."""
        if not self.count:
            return np.zeros((self.steps, 0)), np.zeros((self.steps, 0))
        return -self.most_kw, self.most_kw

    def ranges(self) -> dict[str, tuple[Any, Any]]:
        """Least and largest value of the unknowns."""
        if not self.count:
            return {}
        most = self.most_kw.ravel()
        return {"c": (0.0, most), "x": (0.0, most), "s": (0.0, np.tile(self.params.energy_kwh, self.steps))}

    def prices(self) -> dict[str, np.ndarray]:
        """What each unknown costs, as shares of J times T."""
        if not self.count:
            return {}
        of_all = self.params.p_rated_kw.sum()
        throughput = np.tile(self.params.ageing_price / of_all, self.steps)
        return {"c": throughput, "x": throughput, "m": self.params.missing_price * 3600.0 / of_all}

    def equalities(self, in_d: sparse.csr_array) -> list[Part]:
        """The draw as charge less discharge, and the energy from step to step; ``in_d`` picks the draws among d."""
        if not self.count:
            return []
        p, n, size = self.params, self.count, self.sizes["s"]
        one = sparse.identity(size, format="csr")
        stored = one - sparse.kron(sparse.eye(self.steps, k=-1), sparse.diags(self.kept), format="csr")
        initial_kwh = np.zeros((self.steps, n))
        initial_kwh[0] = self.kept * self.kept * p.initial_kwh  # it has stood by for the step that ends at t = 0
        charge, discharge = (
            np.tile(self.hours * share, self.steps) for share in (p.charge_efficiency, 1.0 / p.discharge_efficiency)
        )
        energy = {"s": stored, "c": -sparse.diags(charge, format="csr"), "x": sparse.diags(discharge, format="csr")}
        return [({"d": in_d, "c": -one, "x": one}, np.zeros(size)), (energy, initial_kwh.ravel())]

    def limits(self, tangents: np.ndarray) -> list[Part]:
        """What is missing at the end, and the converters' capability."""
        if not self.count:
            return []
        last = sparse.eye(self.count, self.sizes["s"], k=self.sizes["s"] - self.count, format="csr")
        missing = {"s": -last, "m": -sparse.identity(self.count, format="csr")}
        parts: list[Part] = [(missing, -self.params.returned_kwh)]
        reactive = np.flatnonzero(self.q_limit_kvar > 0)
        if not len(reactive):
            return parts
        picked = sparse.csr_array(np.eye(self.count)[reactive])
        selected = sparse.kron(sparse.identity(self.steps), picked, format="csr")
        behind = sparse.csr_array(np.eye(self.count, self.n_agents, k=self.n_agents - self.count)[reactive])
        of_g = sparse.kron(sparse.identity(self.steps), behind, format="csr")
        room = np.tile(self.s_rated_kva[reactive], self.steps)
        for theta in tangents:
            active = np.cos(theta) * selected
            parts.append(({"c": active, "x": active, "g": np.sin(theta) * of_g}, room))
        return parts


def storages_of(scenario: Scenario) -> Any:
    """The group of storages of a scenario, None where there are none."""
    return next((device for device in scenario.devices if device.kind == "storage" and device.count), None)

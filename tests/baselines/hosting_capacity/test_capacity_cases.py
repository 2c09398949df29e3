"""Capacities of small feeders against closed forms, each exact to the step of the search.

A site of P MW at unity power factor is fed through r + jx (p.u. on 1 MVA). With the reactive load Q and the current i,
v0^2 = v^2 + 2 (r P + x Q) + (r^2 + x^2) i^2 and P^2 + Q^2 = v^2 i^2 hold exactly.
"""

import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import pytest

from dcgrid_env import Feeder, Scenario, ThreePhaseFeeder
from dcgrid_env.baselines.hosting_capacity.capacity_study import Study
from dcgrid_env.baselines.hosting_capacity.hosting import hosting_capacity
from dcgrid_env.baselines.hosting_capacity.outages import with_outage
from dcgrid_env.baselines.hosting_capacity.sites_together import sites_together
from dcgrid_env.baselines.laws.no_control import NoControl
from dcgrid_env.grid.network import (
    CapacitorTable,
    Network,
    NodeTable,
    PhaseLineTable,
    PhaseLoadTable,
    RatingTable,
    RegulatorTable,
    SourceTable,
    TransformerTable,
)
from dcgrid_env.traces import PowerTrace

FULL = PowerTrace([0.0, 600.0], [1.0, 1.0], "full load", compute_kw=[1.0, 1.0])
IDLE = PowerTrace([0.0, 99990.0, 100000.0], [0.0, 0.0, 1.0], "idle", compute_kw=[0.0, 0.0, 1.0])
STEP_MW = 0.001
KV = 10.0


class Line(NamedTuple):
    """A source, an impedance and a load, from which each closed form follows."""

    r_ohm: float = 0.8
    x_ohm: float = 0.5
    kv: float = KV
    p_kw: float = 300.0
    q_kvar: float = 0.0
    v0: float = 1.0

    @property
    def z(self):
        return self.r_ohm / self.kv**2, self.x_ohm / self.kv**2

    @property
    def load(self):
        return self.p_kw / 1000.0, self.q_kvar / 1000.0

    def at_voltage(self, v, injected_mvar=0.0):
        """Largest site that leaves the voltage v, MW."""
        (r, x), (p, q) = self.z, self.load
        q -= injected_mvar
        z_sq = r * r + x * x
        rest = v**4 + 2.0 * v * v * x * q + z_sq * q * q - self.v0**2 * v * v
        return (math.sqrt(r * r * v**4 - z_sq * rest) - r * v * v) / z_sq - p

    def at_current(self, amps):
        """Largest site that leaves the current, MW."""
        (r, x), (p, q) = self.z, self.load
        i = math.sqrt(3.0) * self.kv * amps / 1000.0
        constant = (q / i) ** 2 + 2.0 * x * q + (r * r + x * x) * i * i - self.v0**2
        return i * i * (math.sqrt(r * r - constant / i**2) - r) - p

    def at_loss(self, loss_kw):
        """Largest site that leaves the loss, MW."""
        return self.at_current(1000.0 * math.sqrt(loss_kw / 1000.0 / self.z[0]) / math.sqrt(3.0) / self.kv)

    def at_step(self, step):
        """Largest site whose connection changes the voltage by a step, p.u., MW."""
        (r, x), (p, q) = self.z, self.load
        half = 0.5 * self.v0**2 - r * p - x * q
        before = math.sqrt(half + math.sqrt(half * half - (r * r + x * x) * (p * p + q * q)))
        return self.at_voltage(before - step)

    def feeder(self, rating_a=None, ratings=()):
        made = Feeder.from_tables(
            name="two", base_kv=self.kv, substation="a", v0_pu=1.0, bus_ids=["a", "b"], p_load_kw=[0.0, self.p_kw],
            q_load_kvar=[0.0, self.q_kvar], from_bus=["a"], to_bus=["b"], r_ohm=[self.r_ohm], x_ohm=[self.x_ohm],
            rating_a=None if rating_a is None else [rating_a],
        )  # fmt: skip
        table = RatingTable(*zip(*(("branch a-b", *row) for row in ratings), strict=True)) if ratings else RatingTable()
        return Feeder.from_network(replace(made.to_network(), rating=table))


def capacities(feeder, *, v0=1.0, trace=FULL, split="test", **fields):
    """What each bus carries alone, MW."""
    return [found.capacity_mw for found in hosting_capacity(study(feeder, v0, trace, split, **fields), ["none"])
            .by_controller["none"]]  # fmt: skip


def study(feeder, v0=1.0, trace=FULL, split="test", **fields):
    scenario = Scenario(
        name="case", feeder=feeder, n_datacenters=1, split=split, trace=(trace,), background={"load_sigma": 0.0},
        source_voltage_pu=v0, power_flow="distflow" if isinstance(feeder, Feeder) else "sweep",
        **{"datacenters.p_rated_kw": 1.0, "datacenters.s_rated_share": 1.1, "datacenters.q_max_share": 0.33},
        **{"inverters.buses": (), "inverters.s_rated_kva": 0.0},
    )  # fmt: skip
    few = {"samples": 1, "window_s": 6.0, "settle_s": 2.0, "load": "peak", "tolerance_mw": STEP_MW, "max_mw": 10.0}
    return Study(scenario=scenario, others=False, **(few | {"v_min_pu": 0.5, "v_max_pu": 1.5} | fields))


def check(found, expected):
    """The largest multiple of the step that is not above the closed form."""
    assert found <= expected + 1e-6
    assert expected < found + STEP_MW + 1e-6


LINES = {
    "plain": Line(),
    "resistive": Line(x_ohm=0.0),
    "reactive": Line(r_ohm=0.05, x_ohm=1.2),
    "no load": Line(p_kw=0.001),
    "inductive load": Line(q_kvar=400.0),
    "capacitive load": Line(q_kvar=-400.0),
    "high source": Line(v0=1.04),
    "local generation": Line(p_kw=-250.0),
    "other base": Line(r_ohm=3.2, x_ohm=2.0, kv=2.0 * KV),
}
V_MIN, AMPS, LOSS_KW = 0.95, 100.0, 30.0
LIMITS = {
    "voltage": (lambda line: line.at_voltage(V_MIN), {"v_min_pu": V_MIN}, None),
    "current": (lambda line: line.at_current(AMPS), {}, AMPS),
    "loss": (lambda line: line.at_loss(LOSS_KW), {"loss_max_kw": LOSS_KW}, None),
    "step": (lambda line: line.at_step(0.02), {"voltage_step_max_pct": 2.0, "trace": IDLE, "split": "train"}, None),
}


@pytest.mark.parametrize("limit", LIMITS)
@pytest.mark.parametrize("name", LINES)
def test_a_line_carries_what_the_closed_form_says(name, limit):
    line, (expected, fields, rating_a) = LINES[name], LIMITS[limit]
    (mw,) = capacities(line.feeder(rating_a), v0=line.v0, **fields)
    check(mw, expected(line))

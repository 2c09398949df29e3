"""Capacities of small feeders against closed forms, each exact to the step of the search.

A site of P MW at unity power factor is fed through r + jx (p.u. on 1 MVA). Q is the reactive load, i the current. Then
v0^2 = v^2 + 2 (r P + x Q) + (r^2 + x^2) i^2, and P^2 + Q^2 = v^2 i^2.
"""

import math
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
import pytest

from dcgrid_env import Feeder, Scenario, ThreePhaseFeeder
from dcgrid_env.apps.hosting.capacity_study import Study
from dcgrid_env.apps.hosting.hosting import hosting_capacity
from dcgrid_env.apps.hosting.load_hours import sampled_windows
from dcgrid_env.apps.hosting.outages import with_outage
from dcgrid_env.apps.hosting.sites_together import sites_together
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
from dcgrid_env.traces.day_course import LOAD_PERCENT

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
        **{"datacenters.buses": feeder.bus_ids[-1:], "inverters.buses": (), "inverters.s_rated_kva": 0.0},
    )  # fmt: skip
    few = {
        "buses": feeder.bus_ids[1:],
        "samples": 1,
        "window_s": 6.0,
        "settle_s": 2.0,
        "load": "peak",
        "tolerance_mw": STEP_MW,
        "max_mw": 40.0,
    }
    asked: dict[str, Any] = few | {"v_min_pu": 0.5, "v_max_pu": 1.5} | fields
    return Study(scenario=scenario, others=False, **asked)


def check(found, expected):
    """The largest multiple of the step that is not above the closed form."""
    assert found <= expected + 1e-6
    assert expected < found + STEP_MW + 1e-6


LINES = {
    "plain": Line(),
    "resistive": Line(x_ohm=0.0),
    "reactive": Line(r_ohm=0.4, x_ohm=1.0),
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


RATINGS = (("", math.nan, 140.0), ("summer", 90.0, 110.0), ("winter", 120.0, math.nan), ("spring", math.nan, 105.0))
"""Season, normal and emergency rating, A; the rating column has 100 A."""


@pytest.mark.parametrize(
    ("rating", "season", "amps", "said"),
    [
        ("normal", "", 100.0, "ratings known for 1 of 1 elements"),
        ("emergency", "", 140.0, "ratings known for 1 of 1 elements (all seasons, emergency)"),
        ("normal", "summer", 90.0, "ratings known for 1 of 1 elements (summer, normal)"),
        ("emergency", "summer", 110.0, "ratings known for 1 of 1 elements (summer, emergency)"),
        ("normal", "winter", 120.0, "ratings known for 1 of 1 elements (winter, normal)"),
        ("emergency", "winter", 140.0,
         "ratings known for 1 of 1 elements (winter, emergency); limited by another rating: branch a-b"),
        ("normal", "spring", 100.0,
         "ratings known for 1 of 1 elements (spring, normal); limited by another rating: branch a-b"),
    ],
)  # fmt: skip
def test_ratings_of_a_season_and_kind_limit_as_the_closed_form_says(rating, season, amps, said):
    line = Line()
    feeder = line.feeder(AMPS, RATINGS)
    (mw,) = capacities(feeder, rating=rating, season=season)
    check(mw, line.at_current(amps))
    assert str(study(feeder, rating=rating, season=season).coverage) == said


def branched(order, ends, *, scale=1.0, rating_a=None):
    """Buses in an order, and branches like ``Line`` between ends; impedances times the scale and powers over it."""
    return Feeder.from_tables(
        name="tree", base_kv=KV, substation="a", v0_pu=1.0, bus_ids=list(order),
        p_load_kw=[0.0 if bus == "a" else 300.0 / scale for bus in order], q_load_kvar=[0.0] * len(order),
        from_bus=[end[0] for end in ends], to_bus=[end[1] for end in ends], r_ohm=[0.8 * scale] * len(ends),
        x_ohm=[0.5 * scale] * len(ends), rating_a=rating_a,
    )  # fmt: skip


@pytest.mark.parametrize(("order", "ends"), [("abc", ("ab", "ac")), ("acb", ("ca", "ba")), ("cab", ("ac", "ab"))])
def test_twin_buses_carry_the_same_in_any_order_of_the_tables(order, ends):
    for mw in capacities(branched(order, ends), v_min_pu=V_MIN):
        check(mw, Line().at_voltage(V_MIN))


@pytest.mark.parametrize("rule", ["equal", "sum"])
def test_sites_on_branches_of_their_own_carry_the_sum(rule):
    asked = study(branched("abc", ("ab", "ac")), v_min_pu=V_MIN)
    together = sites_together(asked, NoControl(), "none", rule)
    for mw in together.mw:
        check(mw, Line().at_voltage(V_MIN))


@pytest.mark.parametrize("scale", [0.5, 4.0])
def test_impedances_times_a_factor_carry_powers_divided_by_it(scale):
    step = STEP_MW / scale
    plain = capacities(branched("abc", ("ab", "bc")), v_min_pu=0.9)
    scaled = capacities(
        branched("abc", ("ab", "bc"), scale=scale), v_min_pu=0.9, tolerance_mw=step, max_mw=40.0 / scale
    )
    np.testing.assert_allclose(np.array(scaled) * scale, plain, atol=1e-9)
    assert plain[0] > plain[1] > 0.0


@pytest.mark.parametrize(("p_kw", "limit"), [(-9000.0, "overvoltage at bus b"), (9000.0, "undervoltage at bus b")])
def test_limits_broken_without_a_site_leave_nothing(p_kw, limit):
    found = hosting_capacity(study(Line(p_kw=p_kw).feeder(), v_min_pu=0.95, v_max_pu=1.05), ["none"])
    (only,) = found.by_controller["none"]
    assert (only.capacity_mw, only.limit) == (0.0, limit)


def test_the_share_of_a_rating_limits_as_a_smaller_rating():
    (mw,) = capacities(Line().feeder(AMPS), loading_max_pct=80.0)
    check(mw, Line().at_current(0.8 * AMPS))


def test_most_windows_is_an_order_statistic_of_the_windows():
    """A line without a noticeable drop: each window alone carries the rating less its load, linear in the site."""
    line = Line(r_ohm=1e-6, x_ohm=0.0, p_kw=1000.0)
    asked = study(line.feeder(AMPS), samples=8, load="day", window_s=6.0, settle_s=2.0)
    (found,) = hosting_capacity(asked, ["none"]).by_controller["none"]
    rated = line.at_current(AMPS) + 1.0
    share = (
        np.interp(np.asarray(sampled_windows(asked).hours), np.arange(25) + 0.5, [*LOAD_PERCENT, LOAD_PERCENT[0]])
        / 100.0
    )
    alone = rated - share
    check(found.capacity_mw, alone.min())
    assert found.most_windows_mw == pytest.approx(np.quantile(alone, 0.05), abs=2 * STEP_MW)
    assert found.half_windows_mw == pytest.approx(np.median(alone), abs=2 * STEP_MW)


NOTHING = ((0.0,) * 3,) * 3
KV_LN = KV / math.sqrt(3.0)
R_OHM, X_OHM = 0.8, 0.5


def diagonal(value):
    return tuple(tuple(value if i == j else 0.0 for j in range(3)) for i in range(3))


def three_phases(buses, *, kw=(100.0, 100.0, 100.0), kv_ln=KV_LN, **tables):
    """Buses of three phases without coupling between them, with a load at the last one."""
    n, last = len(buses), buses[-1]
    return ThreePhaseFeeder.from_network(
        Network(
            name="three",
            source=SourceTable([buses[0]], [KV], [1.0], [0.0], [NOTHING], [NOTHING]),
            node=NodeTable(
                np.repeat(buses, 3).tolist(), [1, 2, 3] * n, [0.0] * 3 * n, [0.0] * 3 * n,
                [KV_LN] * 3 * (n - 1) + [kv_ln] * 3,
            ),
            phase_load=PhaseLoadTable(
                ["load"], [last], ["wye"], ["PQ"], [kv_ln], [kw], [(0.0,) * 3], [0.02], [9.0], [0.01], [()]
            ),
            **tables,
        )
    )  # fmt: skip


def phase_line(i, j, r_ohm=R_OHM, x_ohm=X_OHM, **more):
    return PhaseLineTable(["line"], [i], [j], ["abc"], [1.0], [diagonal(r_ohm)], [diagonal(x_ohm)], [NOTHING], **more)


@pytest.mark.parametrize("kw", [(100.0, 100.0, 100.0), (400.0, 100.0, 50.0), (0.0, 0.0, 450.0)])
@pytest.mark.parametrize("limit", ["voltage", "current"])
def test_the_phase_with_the_largest_load_limits_a_site_of_three_phases(kw, limit):
    """Each phase is a separate line, and the site has a third of its power on each."""
    worst = Line(p_kw=3.0 * max(kw))
    feeder = three_phases(["a", "b"], kw=kw, phase_line=phase_line("a", "b", rating_a=[AMPS]))
    if limit == "voltage":
        (mw,) = capacities(feeder, v_min_pu=0.97, loading_max_pct=1000.0)
        check(mw, worst.at_voltage(0.97))
    else:
        (mw,) = capacities(feeder)
        check(mw, worst.at_current(AMPS))


@pytest.mark.parametrize(
    ("rating", "season", "kva"), [("normal", "", 1000.0), ("normal", "winter", 1200.0), ("emergency", "winter", 1500.0)]
)
@pytest.mark.parametrize("x_percent", [0.0, 6.0])
def test_a_transformer_carries_its_rated_current_at_the_secondary(rating, season, kva, x_percent):
    """Its current is limited to that of its kVA at the rated voltage, which its impedance lowers."""
    transformer = TransformerTable(
        ["t"], ["a"], ["b"], ["abc"], ["wye_grounded"], ["wye_grounded"], [1000.0], [KV], [0.48], [0.0], [x_percent],
        [0.0], [0.0],
    )  # fmt: skip
    ratings = RatingTable(["transformer t"], ["winter"], [1200.0], [1500.0])
    feeder = three_phases(["a", "b"], kv_ln=0.48 / math.sqrt(3.0), transformer=transformer, rating=ratings)
    ohm = x_percent / 100.0 * 0.48**2 / 1.0
    line = Line(r_ohm=1e-9, x_ohm=ohm, kv=0.48)
    (mw,) = capacities(feeder, rating=rating, season=season)
    check(mw, line.at_current(kva / 0.48 / math.sqrt(3.0)))


def regulator(tap, kva_per_phase=1000.0):
    return RegulatorTable(
        ["reg"], ["bank"], ["a"], ["m"], ["abc"], ["a"], [KV_LN], [kva_per_phase], [0.0], [0.0], [tap], [0], [-16],
        [16], [0.00625], [120.0], [2.0], [20.0], [100.0], [0.0], [0.0], [30.0], [2.0], [0], [0.0],
    )  # fmt: skip


@pytest.mark.parametrize("tap", [-8, 0, 8])
def test_a_regulator_at_a_fixed_tap_limits_by_its_larger_current(tap):
    ratio = 1.0 + 0.00625 * tap
    feeder = three_phases(["a", "m"], regulator=regulator(tap))
    (mw,) = capacities(feeder)
    check(mw, 3.0 * min(1.0, ratio) - 0.3)


@pytest.mark.parametrize("tap", [-4, 8, 16])
def test_a_tap_limits_as_a_source_of_its_ratio(tap):
    feeder = three_phases(["a", "m", "b"], regulator=regulator(tap, 1e6), phase_line=phase_line("m", "b"))
    mw = capacities(feeder, v_min_pu=0.94, buses=("b",))
    check(mw[0], Line(v0=1.0 + 0.00625 * tap).at_voltage(0.94))


@pytest.mark.parametrize("outage", [None, "capacitor bank"])
@pytest.mark.parametrize("kvar", [300.0, 900.0])
def test_a_capacitor_bank_out_of_service_supports_the_voltage_no_longer(outage, kvar):
    bank = CapacitorTable(["bank"], ["b"], ["wye"], [KV_LN], [(kvar / 3.0,) * 3], ["on"])
    asked = study(three_phases(["a", "b"], phase_line=phase_line("a", "b"), capacitor=bank), v_min_pu=V_MIN)
    if outage is not None:
        asked = asked.with_outage(with_outage(asked.scenario, outage))
    (found,) = hosting_capacity(asked, ["none"]).by_controller["none"]
    injected = 0.0 if outage else kvar / 1000.0 * V_MIN**2
    check(found.capacity_mw, Line().at_voltage(V_MIN, injected))


def test_a_regulator_bank_out_of_service_is_at_its_neutral_tap_with_the_ratings_of_an_outage():
    """Normal: 600 kVA a phase at tap 8 of 5 % more voltage. Out of service: the line's emergency rating limits."""
    ratings = RatingTable(["line line", "regulator reg"], ["", ""], [math.nan, math.nan], [150.0, 9000.0])
    feeder = three_phases(
        ["a", "m", "b"], regulator=regulator(8, 600.0), phase_line=phase_line("m", "b", rating_a=[AMPS]), rating=ratings
    )
    asked = study(feeder, outage_rating="emergency", buses=("b",))
    without = asked.with_outage(with_outage(asked.scenario, "regulator bank"))
    (before,) = hosting_capacity(asked, ["none"]).by_controller["none"]
    (after,) = hosting_capacity(without, ["none"]).by_controller["none"]
    check(before.capacity_mw, Line(v0=1.05).at_current(min(AMPS, 600.0 / KV_LN / 1.05)))
    check(after.capacity_mw, Line().at_current(150.0))

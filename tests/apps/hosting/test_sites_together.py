"""Sizes of several sites at once, against closed forms on two buses and against what must hold."""

import dataclasses

import pytest

from dcgrid_env import Feeder, Scenario, load_feeder
from dcgrid_env.apps.hosting.capacity_study import Study
from dcgrid_env.apps.hosting.hosting import hosting_capacity
from dcgrid_env.apps.hosting.sites_together import LimitsBroken, sites_together
from dcgrid_env.baselines.laws.no_control import NoControl
from dcgrid_env.traces import PowerTrace

FULL = PowerTrace([0.0, 600.0], [1.0, 1.0], "full load", compute_kw=[1.0, 1.0])
SHORT = {"samples": 2, "window_s": 10.0, "settle_s": 4.0, "load": "peak"}


def study_of(feeder, buses, **fields):
    scenario = Scenario(
        name="study", feeder=feeder, n_datacenters=1, split="test", trace=(FULL,), source_voltage_pu=1.0,
        background={"load_sigma": 0.0}, inverters={"buses": (), "s_rated_kva": 0.0},
        datacenters={"p_rated_kw": 1.0, "s_rated_share": 1.1, "q_max_share": 0.33},
    )  # fmt: skip
    return Study(scenario=scenario, others=False, buses=buses, **(SHORT | fields))


def fork(rating_a):
    """Two buses, each behind a rated branch that limits it."""
    return Feeder.from_tables(
        name="fork", base_kv=10.0, substation="a", v0_pu=1.0, bus_ids=["a", "b", "c"], p_load_kw=[0.0, 1.0, 1.0],
        q_load_kvar=[0.0, 0.0, 0.0], from_bus=["a", "a"], to_bus=["b", "c"], r_ohm=[0.01, 0.01], x_ohm=[0.01, 0.01],
        rating_a=rating_a,
    )  # fmt: skip


def chain():
    """Two buses in a row behind one rated branch, which they share."""
    return Feeder.from_tables(
        name="chain", base_kv=10.0, substation="a", v0_pu=1.0, bus_ids=["a", "b", "c"], p_load_kw=[0.0, 1.0, 1.0],
        q_load_kvar=[0.0, 0.0, 0.0], from_bus=["a", "b"], to_bus=["b", "c"], r_ohm=[0.01, 0.01], x_ohm=[0.01, 0.01],
        rating_a=[100.0, 40.0],
    )  # fmt: skip


MW_PER_A = 3.0**0.5 * 10.0 / 1000.0


@pytest.mark.parametrize("rule", ["equal", "sum"])
def test_sites_that_share_nothing_have_what_each_has_alone(rule):
    study = study_of(fork([50.0, 100.0]), ("b", "c"), tolerance_mw=0.005, max_mw=3.0)
    found = sites_together(study, NoControl(), "none", rule)
    assert found.mw == pytest.approx((50.0 * MW_PER_A - 0.001, 100.0 * MW_PER_A - 0.001), abs=0.008)
    assert found.limits == ("overload of branch a-b", "overload of branch a-c")


@pytest.mark.slow
def test_sites_that_share_a_branch_divide_it():
    study = study_of(chain(), ("b", "c"), tolerance_mw=0.005, max_mw=3.0)
    equal = sites_together(study, NoControl(), "none", "equal")
    assert equal.sum_mw == pytest.approx(100.0 * MW_PER_A - 0.002, abs=0.012)
    # The farther one ends at the rating of its own branch; the other one takes the rest.
    assert equal.mw == pytest.approx((60.0 * MW_PER_A - 0.001, 40.0 * MW_PER_A - 0.001), abs=0.012)
    most = sites_together(study, NoControl(), "none", "sum")
    assert most.sum_mw == pytest.approx(equal.sum_mw, abs=0.006)


@pytest.mark.slow
def test_together_is_less_than_each_alone_and_the_sum_is_at_least_that_of_equal_sizes():
    study = study_of(load_feeder("ieee33"), ("6", "18", "33"), tolerance_mw=0.02, max_mw=2.0)
    study = dataclasses.replace(study, scenario=study.scenario.replace(source_voltage_pu=1.05))
    alone = {c.bus: c.capacity_mw for c in hosting_capacity(study, ["none"]).by_controller["none"]}
    equal, most = (sites_together(study, NoControl(), "none", rule) for rule in ("equal", "sum"))
    for found in (equal, most):
        assert all(0.0 <= mw <= alone[bus] for bus, mw in zip(found.buses, found.mw, strict=True))
        assert all(limit.startswith("undervoltage at bus") for limit in found.limits)
    assert most.sum_mw >= equal.sum_mw
    assert min(equal.mw) >= min(most.mw)


@pytest.mark.parametrize(
    ("buses", "rule", "message"),
    [
        (("b",), "equal", "needs at least two buses"),
        (None, "equal", "needs at least two buses"),
        (("b", "c"), "fair", "must be one of equal, sum, got 'fair'"),
    ],
)
def test_what_cannot_be_asked(buses, rule, message):
    with pytest.raises(ValueError, match=message):
        sites_together(study_of(chain(), buses), NoControl(), "none", rule)


def test_limits_that_are_broken_without_a_site_are_named():
    study = study_of(chain(), ("b", "c"), v_min_pu=1.01)
    with pytest.raises(ValueError, match="limits are broken without any site: undervoltage at bus"):
        sites_together(study, NoControl(), "none", "equal")


def test_an_overload_counts_only_if_a_site_is_behind_it():
    feeder = Feeder.from_tables(
        name="star", base_kv=10.0, substation="a", v0_pu=1.0, bus_ids=["a", "b", "c", "d"],
        p_load_kw=[0.0, 100.0, 1.0, 1.0], q_load_kvar=[0.0] * 4, from_bus=["a"] * 3, to_bus=["b", "c", "d"],
        r_ohm=[0.01] * 3, x_ohm=[0.01] * 3, rating_a=[1.0, 10.0, 10.0],
    )  # fmt: skip
    found = sites_together(study_of(feeder, ("c", "d"), max_mw=1.0), NoControl(), "none", "equal")
    alone = hosting_capacity(study_of(feeder, ("c", "d"), max_mw=1.0), ["none"]).by_controller["none"]
    assert found.mw == tuple(one.capacity_mw for one in alone)  # the branches are apart
    assert min(found.mw) > 0.1
    with pytest.raises(LimitsBroken, match="no site fits at bus b: overload of"):
        sites_together(study_of(feeder, ("b", "d"), max_mw=1.0), NoControl(), "none", "equal")

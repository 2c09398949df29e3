"""Scenarios by name, and variants of them."""

import numpy as np
import pytest

from dcgrid_env import DcgridVectorEnv, ScenarioError, scenario_hash
from dcgrid_env.agents.algorithms.analytic import variant
from dcgrid_env.agents.training.config import scenarios
from helpers.three_phase import SCENARIOS


def test_names_are_separated_by_commas():
    found = scenarios(" toy6, ieee123 ,", split="train", observe="feeder")
    assert [s.name for s in found] == ["toy6", "ieee123"]
    assert {(s.split, s.sensing.observe) for s in found} == {("train", "feeder")}


@pytest.mark.parametrize("names", ["", " , "])
def test_no_name(names):
    with pytest.raises(ValueError, match=r"must name at least one scenario \(dcgrid list\)"):
        scenarios(names)


def test_an_unknown_name():
    with pytest.raises(ScenarioError, match="no scenario 'ieee124'"):
        scenarios("toy6,ieee124")


@pytest.mark.parametrize("name", ["toy6", "ieee123", "ieee33-weak", "fault", "scale-32"])
def test_a_variant_has_other_places_and_ratings_and_the_same_widths(name):
    (base,) = scenarios(name, split="train", horizon=3)
    one, again = (variant(base, np.random.default_rng(5)) for _ in range(2))
    other = variant(base, np.random.default_rng(6))
    assert scenario_hash(one) == scenario_hash(again) != scenario_hash(other)
    assert (one.datacenters.count, one.inverters.count, one.split) == (
        base.datacenters.count,
        base.inverters.count,
        "train",
    )
    assert one.datacenters.buses is None
    sites = one.datacenters.parameters.p_rated_kw / base.datacenters.parameters.p_rated_kw
    others = one.inverters.parameters.s_rated_kva / base.inverters.parameters.s_rated_kva
    for share, low, high in ((sites, 0.5, 1.1), (others, 0.5, 2.0)):
        assert low <= share.min() <= share.max() <= high
        assert len(set(share)) == len(share)
    assert 0.0 < abs(one.source_voltage_pu - base.source_voltage_pu) <= 0.01
    loads = dict(zip(base.feeder.bus_ids, base.feeder.p_load_kw, strict=True))
    assert len(set(one.inverters.buses)) == base.inverters.count
    assert all(loads[str(bus)] > 0.0 for bus in one.inverters.buses)
    env = DcgridVectorEnv(2, one)
    seen, _ = env.reset(seed=0)
    _, rewards, *_ = env.step(np.zeros(env.action_space.shape or (), np.float32))
    assert np.isfinite(seen).all()
    assert np.isfinite(rewards).all()


@pytest.mark.parametrize("name", SCENARIOS)
def test_variants_of_three_phase_feeders_have_the_phases_that_inverters_need(name):
    base = SCENARIOS[name]()
    made = variant(base, np.random.default_rng(0))
    assert made.inverters.count == base.inverters.count
    single = base.replace(inverters={"buses": base.inverters.buses[:1], "s_rated_kva": 50.0, "phases": "b"})
    for seed in range(5):
        (bus,) = variant(single, np.random.default_rng(seed)).inverters.buses
        assert "b" in base.feeder.bus_phases[base.feeder.index(bus)]

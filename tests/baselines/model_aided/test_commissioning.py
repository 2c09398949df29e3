"""What agents know: the regression against its definition, placements, and moments carried to another feeder."""

import numpy as np
import pytest

from dcgrid_env import forecast, make_scenario
from dcgrid_env.baselines.model_aided.commissioning import commission, site_of
from dcgrid_env.baselines.model_aided.decision import own_error
from dcgrid_env.baselines.model_aided.moment_flow import MomentFlow
from dcgrid_env.baselines.model_aided.regression import regressed


def placed(scenario, seeds):
    return np.array([forecast(scenario, seed).buses for seed in seeds])


@pytest.mark.parametrize("preset", ["ieee33-weak", "mixed"])
def test_the_regression_is_that_of_its_definition(preset):
    site = site_of(make_scenario(preset))
    buses = placed(site.scenario, [0])
    known = commission(site, buses)
    flow = MomentFlow(site, buses[0])
    draw = site.points.p_agent_kw
    moved = np.random.default_rng(0).normal(0.0, 20.0, draw.shape)
    v = flow.voltages(np.broadcast_to(known.origin_kvar, draw.shape))
    there = v + moved @ known.by_q[0]
    again = regressed(site, known, there, there @ flow.observed_share.T, moved)
    noise = site.scenario.sensing.noise_pu**2 + (0.1 * site.law.floor_pu) ** 2
    for i in (0, site.scenario.n_agents - 1):
        more = draw[:, i : i + 1] - known.mean_kw[0, i]
        e = there - moved[:, i : i + 1] * known.by_q[0, i] + more * known.by_draw[0, i]
        own = e @ flow.observed_share[i]
        key = draw[:, i] if site.scheduled[i] else own
        n_level = known.key.shape[2]
        for level, rows in enumerate(np.array_split(np.argsort(key, kind="stable"), n_level)):
            c = np.cov(e[rows].T, own[rows], bias=True)
            gain = c[:-1, -1] / (c[-1, -1] + noise)
            spread = np.sqrt(np.diag(c)[:-1] - gain * c[:-1, -1] + site.law.floor_pu**2)
            assert again.gain[0, i, level] == pytest.approx(gain, abs=1e-6)
            assert 1.0 / again.inverse_spread[0, i, level] == pytest.approx(spread, abs=1e-8)
            assert again.base_pu[0, i, level] == pytest.approx(e[rows].mean(axis=0), abs=1e-10)
            assert again.key[0, i, level] == pytest.approx(key[rows].mean(), rel=1e-9)


def test_placements_are_what_each_is_alone():
    site = site_of(make_scenario("ieee123"))
    buses = placed(site.scenario, range(3))
    together, alone = commission(site, buses), commission(site, buses[1:2])
    for field, own in zip(together, alone, strict=True):
        assert (field[1] == own[0]).all()
    e = own_error(together, np.ones((3, site.scenario.n_agents)), together.mean_kw, together.origin_kvar)
    assert (e == 1.0).all()


def test_moments_are_carried_over_to_another_feeder_of_the_family():
    scenario = make_scenario("zero-shot")
    first, second = scenario.member(0), scenario.member(128)
    there = site_of(second, points=site_of(first).points).points
    drawn = site_of(second).points
    assert (there.p_agent_kw == drawn.p_agent_kw).all()
    assert there.p_load_kw.mean(axis=0) == pytest.approx(drawn.p_load_kw.mean(axis=0), rel=0.03)
    assert there.p_load_kw.std(axis=0) == pytest.approx(drawn.p_load_kw.std(axis=0), rel=0.35)
    with pytest.raises(ValueError, match="of as many buses alone"):
        there.on(make_scenario("ieee33"))


@pytest.mark.parametrize(("v0_pu", "dearer"), [(1.05, False), (0.85, True)])
def test_waiting_costs_more_where_no_moment_is_better(v0_pu, dearer):
    """A source at 0.85 p.u. leaves the band always."""
    site = site_of(make_scenario("ieee33", source_voltage_pu=v0_pu))
    known = commission(site, placed(site.scenario, [0]))
    assert (known.waiting >= site.waiting).all()
    assert (known.waiting <= site.never).all()
    assert (known.waiting > site.waiting).any() == dearer

"""Cooling and auxiliaries of sites: a lag that any step resolves exactly, within the bounds of what is observed."""

import math
from typing import Any

import numpy as np
import pytest

from dcgrid_env import Cooling, DcgridEnv, ScenarioError, action_layout, make_scenario
from dcgrid_env.baselines import NoControl, rollout
from dcgrid_env.devices.datacenter.cooled_site import CooledSite
from dcgrid_env.engine.simulation import Simulation


def cooled(cooling=None, **changes):
    return make_scenario("toy6", **({"datacenters.cooling": cooling or {}} | changes))


def draws(scenario, steps):
    """Draw of the site and its cooling state in each step at the top clock."""
    simulation = Simulation(scenario, 1)
    transition = simulation.reset([0])
    rows = [transition.state]
    action = np.zeros((1, action_layout(scenario).n))
    action[0, 0] = 1.0
    rows += [simulation.step(action).state for _ in range(steps)]
    return rows


def test_the_lag_is_that_of_first_order_whatever_the_step():
    site: Any = CooledSite(Cooling(cooling_share=0.4, time_constant_s=7.0, auxiliary_share=0.0), 1.0)
    params, none, energies = cooled().datacenters.parameters, np.zeros((1, 1)), []
    for dt_s in (0.5, 2.0, 20.0):
        own = site.step(params, site.initial(params, none), None, none + 500.0, (), None, dt_s)[0]
        drawn_kws = 0.0
        for _ in range(round(60.0 / dt_s)):
            own, _, p_kw = site.step(params, own, None, none + 2500.0, (), None, dt_s)
            drawn_kws += float(p_kw[0, 0]) * dt_s
        assert own.cooling_end_kw[0, 0] == pytest.approx(1000.0 - 800.0 * math.exp(-60.0 / 7.0))
        energies.append(drawn_kws)
    exact = 60.0 * 3500.0 - 800.0 * 7.0 * (1.0 - math.exp(-60.0 / 7.0))
    assert energies == pytest.approx([exact] * 3)


def test_it_has_settled_at_the_beginning_and_the_pue_is_stated():
    s = cooled({"cooling_share": 0.3, "time_constant_s": 1e4, "auxiliary_share": 0.1})
    first = draws(s, 0)[0]
    own = first.devices[0].features[0]
    assert own.cooling_kw[0, 0] == pytest.approx(0.3 * own.computing_kw[0, 0])
    assert first.p_kw[0, 0] == pytest.approx(1.3 * own.computing_kw[0, 0] + 250.0)
    assert s.datacenters.cooling
    assert s.datacenters.cooling.pue_at_rating == pytest.approx(1.4)
    at_once = cooled({"cooling_share": 0.3, "time_constant_s": 0.0, "auxiliary_share": 0.0})
    assert rollout(at_once, NoControl(), [0]).metrics()[0]["pue"] == pytest.approx(1.3)
    figures = rollout(s, NoControl(), [0]).metrics()[0]
    assert figures["pue"] > 1.0
    assert figures["cooling_kwh"] > 0.0


@pytest.mark.slow
def test_the_converter_holds_all_of_it_and_observations_stay_within_their_bounds():
    s = cooled(Cooling(), datacenters={"boost_share": 1.2})
    sites = s.datacenters
    assert sites.converter_kva == pytest.approx([1.1 * 1.25 * 2500.0])
    assert sites.q_limit_kvar == pytest.approx([825.0])
    assert sites.largest_draw_share == pytest.approx(1.2 * 1.2 + 0.05)
    env = DcgridEnv(s.replace(horizon=40))
    observed, _ = env.reset(seed=0)
    over = False
    while not over:
        assert env.observation_space.contains(observed)
        observed, *_, over, _ = env.step(np.ones(action_layout(s).n, np.float32))


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"cooling_share": -0.1}, "cooling.cooling_share is -0.1"),
        ({"time_constant_s": -1.0}, "cooling.time_constant_s is -1.0"),
        ({"auxiliary_share": 3.0}, "cooling.auxiliary_share is 3.0"),
        ("on", "datacenters.cooling is 'on'; give Cooling"),
    ],
)
def test_bad_settings_are_refused(wrong, message):
    with pytest.raises(ScenarioError, match=message):
        cooled(wrong)

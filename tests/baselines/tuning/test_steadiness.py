"""A droop is stable and without a limit cycle; other gains are reduced or left out."""

import pytest

from dcgrid_env import PRESETS, make_scenario
from dcgrid_env.baselines import Droop, make_controller
from dcgrid_env.baselines.laws.stability import ClosedLoops, is_stable, spectral_radius, worst_radius
from dcgrid_env.baselines.tuning.search import tune
from dcgrid_env.baselines.tuning.steadiness import drawn_back, has_limit_cycle, with_constant_inputs

REGULATORS = ("ieee13-3ph", "ieee34-3ph", "ieee123-3ph", "ieee123-3ph-day")
"""Presets with acting regulators, whose gains are tuned with the regulators' own data."""
SWINGING = Droop(11.2, 0.07105, 0.1109)
"""Gains that swing the clocks of `ride-through` over their whole range every second: a spectral radius of 3.3."""


@pytest.mark.parametrize("law", ["droop", "droop-q"])
@pytest.mark.parametrize("preset", [name for name in PRESETS if name not in REGULATORS])
def test_the_tuned_droop_of_every_preset_is_steady(law, preset):
    scenario = make_scenario(preset, split="validation")
    droop = make_controller(f"{law}-tuned", scenario)
    assert isinstance(droop, Droop)
    assert is_stable(ClosedLoops([scenario]).largest_radius(droop))
    assert not has_limit_cycle(scenario, droop, 20)


def test_a_limit_cycle_is_found_where_the_linear_loop_is_unstable_and_not_where_it_is_stable():
    scenario = make_scenario("ride-through", split="validation")
    assert worst_radius(scenario, SWINGING) > 3.0
    assert has_limit_cycle(scenario, SWINGING, 4)
    assert not has_limit_cycle(scenario, Droop(1.0, 0.05, 0.1), 4)


def test_demand_that_alternates_is_no_limit_cycle():
    """On `training` the sites' power falls and rises every few steps by itself; with held inputs nothing moves."""
    scenario = make_scenario("training", split="validation")
    held = with_constant_inputs(scenario)
    assert held.background.load_sigma == held.sensing.noise_pu == 0.0
    droop = make_controller("droop-tuned", scenario)
    assert isinstance(droop, Droop)
    assert not has_limit_cycle(scenario, droop, 4)


def test_gains_are_drawn_back_to_the_bound_and_no_further():
    scenario = make_scenario("toy6", split="validation")
    loops = ClosedLoops([scenario])
    steep = {"k_p_mw_per_pu": 10.0, "k_q_mvar_per_pu_s": 100.0, "alpha_per_s": 0.1}
    found = drawn_back(loops, steep)
    factor = found["k_q_mvar_per_pu_s"] / 100.0
    assert [value / steep[name] for name, value in found.items()] == pytest.approx([factor] * 3, rel=1e-3)
    assert 0.99 < loops.largest_radius(Droop(**found)) <= 1.0
    assert loops.largest_radius(Droop(**{name: 1.01 * value for name, value in found.items()})) > 1.0
    gentle = {"k_p_mw_per_pu": 0.0, "k_q_mvar_per_pu_s": 1.0, "alpha_per_s": 0.1}
    assert drawn_back(loops, gentle) == gentle


def test_the_radius_of_several_scenarios_is_the_largest():
    toy, weak = (make_scenario(name, split="validation") for name in ("toy6", "ieee33-weak"))
    droop = Droop(1.0, 20.0, 0.1)
    each = [ClosedLoops([scenario]).largest_radius(droop) for scenario in (toy, weak)]
    assert ClosedLoops([toy, weak]).largest_radius(droop) == max(each)
    assert weak.datacenters.buses is not None
    where = weak.datacenters.buses + weak.inverters.buses
    assert each[1] == spectral_radius(weak, where, 1.0, 20.0, alpha_per_s=0.1)


@pytest.mark.slow
def test_a_search_that_ends_at_unstable_gains_is_repeated_within_the_bound():
    scenario = make_scenario("sync", split="validation", horizon=10)
    found = tune("droop-q", [scenario], episodes=1)
    assert found.spectral_radius is not None
    assert found.spectral_radius <= 1.0 + 1e-9
    assert found.spectral_radius == worst_radius(scenario, Droop(**found.parameters))
    assert tune("constant-q", [scenario], episodes=1).spectral_radius is None


@pytest.mark.slow
def test_a_droop_that_swings_at_all_gains_is_refused(monkeypatch):
    monkeypatch.setattr("dcgrid_env.baselines.tuning.search.has_limit_cycle", lambda *_: True)
    with pytest.raises(ValueError, match=r"tune: 'droop-q' is not stable on toy6 at any of \d+ sets of gains"):
        tune("droop-q", [make_scenario("toy6", split="validation", horizon=2)], episodes=1)

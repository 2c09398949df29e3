"""The safe family: its bounds are those of the stability module, and its trained networks keep to them."""

import numpy as np
import pytest

from dcgrid_env import make_scenario
from dcgrid_env.agents import Policy
from dcgrid_env.agents.algorithms.safe import Safe, main
from dcgrid_env.agents.policy.monotone import MonotoneNetwork
from dcgrid_env.agents.policy.slope_bounds import slope_bounds
from dcgrid_env.baselines.laws.stability import spectral_radius


def alike():
    """toy6 with the same reactive limit at every agent, so that equal shares are equal Mvar."""
    return make_scenario("toy6", inverters={"s_rated_kva": 825.0})


def test_the_reactive_bound_is_the_integrating_droops():
    scenario = alike()
    slope, _ = slope_bounds(scenario)
    k_q = slope * 0.825 / scenario.cost.band_pu / scenario.dt_s
    buses = (4, 3, 5)
    assert spectral_radius(scenario, buses, 0.0, 0.999 * k_q) <= 1.0
    assert spectral_radius(scenario, buses, 0.0, 1.001 * k_q) > 1.0


def test_the_clocks_bound_is_the_proportional_droops_that_serves_its_backlog_at_once():
    scenario = alike()
    _, slope = slope_bounds(scenario)
    half_range_mw = 0.5 * (1.0 - 210.0 / 1410.0) * 0.77 * 2.5
    k_p = slope * half_range_mw / scenario.cost.band_pu
    buses = (4, 3, 5)
    assert spectral_radius(scenario, buses, 0.999 * k_p, 0.0, alpha_per_s=1.0) <= 1.0 + 1e-9
    assert spectral_radius(scenario, buses, 1.01 * k_p, 0.0, alpha_per_s=1.0) > 1.0


def test_a_late_measurement_tightens_the_reactive_bound():
    now, late = (slope_bounds(alike().replace(sensing={"delay_steps": m}))[0] for m in (0, 2))
    assert late / now == pytest.approx(np.sin(np.pi / 10))
    # The scalar loop q' = q - k q(t - 2): within the bound the roots of z^3 - z^2 + k are within the unit circle.
    for k, inside in ((2.0 * late / now * 0.999, True), (2.0 * late / now * 1.001, False)):
        assert (np.abs(np.roots([1.0, -1.0, 0.0, k])).max() <= 1.0) == inside


@pytest.mark.slow
def test_a_run_keeps_to_the_bounds(tmp_path, capsys):
    cfg = Safe("toy6", out=tmp_path / "run", updates=2, num_envs=2, validation_episodes=2, margin=0.4, hidden=(4,))
    policy = Policy.load(main(cfg) / "policy.safetensors")
    reactive, clock = slope_bounds(make_scenario("toy6"))
    networks = policy.networks
    site, inverter = networks["datacenter"], networks["inverter"]
    assert isinstance(site, MonotoneNetwork)
    assert isinstance(inverter, MonotoneNetwork)
    assert [head.slope for head in site.heads] == pytest.approx([0.4 * clock, 0.4 * reactive])
    assert inverter.heads[0].slope == pytest.approx(0.4 * reactive)
    assert [head.offset for head in site.heads] == [True, False]
    seen = {int(i) for head in site.heads for i in head.columns}
    assert not seen & {0, 1, 2, 3, 4, 8, 11}  # voltage, its change, p, q and its limit, backlog, what is needed


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"margin": 1.0}, "margin is 1.0; give at least 1e-06 and at most 0.999999"),
        ({"view": "centralised"}, "a safe policy is shared and local"),
        ({"observe": "feeder"}, "a safe policy is shared and local"),
        ({"history": 2}, "history is 2; the bound on the gain is that of a policy without one: give 0"),
    ],
)
def test_what_cannot_be_safe_is_named(tmp_path, settings, message):
    with pytest.raises(ValueError, match=message):
        main(Safe("toy6", out=tmp_path / "run", **settings))
    assert not (tmp_path / "run").exists()

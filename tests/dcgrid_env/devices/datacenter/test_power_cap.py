"""The power cap: steps worked by hand, published figures, and that no site draws more than its cap."""

import numpy as np
import pytest

from dcgrid_env import PowerCapDvfs, PrefillDecodeDvfs, make_scenario
from dcgrid_env.baselines import find_controller, rollout
from dcgrid_env.devices import DataCenterParams

SITE = DataCenterParams(*(np.array([v]) for v in (1000.0, 200.0, 800.0, 210.0, 1400.0, 1100.0, 330.0)))
PLENTY = 1e9


def busy(law, cap, compute, memory):
    """Speed and dynamic power as shares of those without a cap, with more work than can be done."""
    served, power = law.serve(SITE, np.array([1400.0 * cap]), PLENTY * np.array([[compute, memory]]))
    return float(served.sum()) / 800.0, float(power[0]) / 800.0


def test_a_cap_that_half_the_clock_meets():
    # 0.4 / 2 + 0.6 / 8 = 0.275 in prefill; 0.5 (0.34 + 0.66 / 8) = 0.21125 in decode, 1.02 times as long.
    assert busy(PowerCapDvfs(), 0.275, 1.0, 0.0) == pytest.approx((0.5, 0.275), rel=1e-12)
    assert busy(PowerCapDvfs(), 0.21125, 0.0, 1.0) == pytest.approx((1.0 / 1.02, 0.4225), rel=1e-12)
    # Both: 600 kW of prefill at half its speed, 400 kW of decode at full speed, take 0.75 x 2 + 0.5 = 2 intervals.
    served, power = PowerCapDvfs(decode_draw_share=0.2).serve(SITE, np.array([385.0]), np.array([[600.0, 400.0]]))
    np.testing.assert_allclose(served, [[300.0, 200.0]])
    np.testing.assert_allclose(power, [600.0 * 2 * 0.275 / 2 + 200.0])


def test_the_energy_of_training_under_a_cap_of_150_of_250_w():
    # Idle 0.2 of the rating: a cap of 0.6 is 0.5 of the dynamic power. Published: 14 % less energy.
    speed, power = busy(PowerCapDvfs(), 0.5, 1.0, 0.0)
    assert 1.0 - (0.2 + 0.8 * power) / speed == pytest.approx(0.14, abs=0.02)


@pytest.mark.parametrize("a", [0.0, 0.4, 1.0])
def test_compute_draws_its_cap_and_is_never_slower_than_at_that_share_of_the_clock(a):
    law = PowerCapDvfs(compute_linear_share=a)
    for cap in np.linspace(0.15, 1.0, 35):
        speed, power = busy(law, cap, 1.0, 0.0)
        assert power == pytest.approx(cap, rel=1e-12)  # Newton's steps are enough
        assert speed >= cap - 1e-12


@pytest.mark.parametrize("law", [PowerCapDvfs(), PowerCapDvfs(0.0, 1.0, 1.0, 0.0), PowerCapDvfs(0.1, 0.0, 0.0, 1.0)])
def test_no_cap_is_the_top_clock_to_the_bit(law):
    work = np.random.default_rng(0).uniform(0.0, 800.0, (200, 1, 2))
    top = np.full((200, 1), 1400.0)
    for found, expected in zip(law.serve(SITE, top, work), PrefillDecodeDvfs().serve(SITE, top, work), strict=True):
        np.testing.assert_array_equal(found, expected)


@pytest.mark.parametrize("value", [-0.1, 1.1, float("nan"), None])
def test_a_share_that_is_none_is_refused(value):
    with pytest.raises(ValueError, match=rf"PowerCapDvfs: decode_draw_share is {value!r}; give a share from 0 to 1"):
        PowerCapDvfs(decode_draw_share=value)


def test_a_scenario_with_a_cap_runs_and_has_a_hash_of_its_own():
    scenario = make_scenario("ieee33-weak", trace="code", datacenters={"clock_law": "power-cap"}, horizon=20)
    assert scenario.datacenters.clock_law == PowerCapDvfs()
    capped, clocked = (
        rollout(scenario.replace(datacenters={"clock_law": law}), find_controller("droop", scenario), seeds=[0])
        for law in ("power-cap", "prefill-decode")
    )
    assert capped.metrics()[0]["J"] != clocked.metrics()[0]["J"]

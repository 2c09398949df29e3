"""Batch sizes: less power at the same rate, more work at the same power, and longer to the first token."""

import numpy as np
import pytest

from dcgrid_env import Batching, DcgridVectorEnv, Recorder, action_layout, make_scenario


def course(batch: float, **changes):
    """Metrics of an episode at one setting of the channel ``batch`` and the top clock, and its last state."""
    s = make_scenario("bursty", horizon=30, datacenters={"batching": Batching(**changes)})
    env = DcgridVectorEnv(1, s)
    env.reset(seed=[4])
    recorder, values = Recorder(s, env.transition), {"clock": 1.0, "batch": batch}
    action = np.array([[values.get(name, 0.0) for _, name in action_layout(s).names]], np.float32)
    while not recorder.over:
        env.step(action)
        recorder.add(env.transition)
    return recorder.series(0).metrics(), recorder.series(0)


def test_at_rest_it_is_the_scenario_without_batches():
    s = make_scenario("bursty", horizon=5)
    rest = next(c for c in s.replace(datacenters={"batching": {}}).devices[0].channels if c.name == "batch")
    at = float(2.0 * (rest.rest[0] - rest.lowest[0]) / (rest.highest[0] - rest.lowest[0]) - 1.0)
    metrics, series = course(at)
    env = DcgridVectorEnv(1, s.replace(horizon=30))
    env.reset(seed=[4])
    for _ in range(30):
        env.step(np.where(action_layout(s).is_channel("clock"), 1.0, 0.0)[None].astype(np.float32))
    assert series.p_kw[-1] == pytest.approx(env.transition.state.p_kw[0], rel=1e-6)
    assert metrics["cost_gathering"] == pytest.approx(0.0, abs=1e-6)
    assert metrics["batch_mean"] == pytest.approx(64.0, rel=1e-5)


def test_larger_batches_draw_less_and_make_requests_wait():
    (small, at_small), (large, at_large) = course(-1.0), course(1.0)
    assert small["batch_mean"] == pytest.approx(8.0)
    assert large["batch_mean"] == pytest.approx(512.0)
    served = [float(at.served_kw.sum()) for at in (at_small, at_large)]
    sites = slice(3)
    dynamic = [float((at.p_kw[:, sites] - 230.0).sum()) for at in (at_small, at_large)]
    energy = [1.0 - 0.3 + 0.3 * 64.0 / b for b in (8.0, 512.0)]
    idle_kw = dynamic[1] - served[1] * energy[1]  # below the idle draw where a site has less than that to do
    assert dynamic[0] == pytest.approx(served[0] * energy[0] + idle_kw, rel=1e-6)
    assert large["unserved_kws"] <= small["unserved_kws"]
    assert large["cost_gathering"] > 0.0 == small["cost_gathering"]
    waits = 0.1 * (512.0 / 64.0 - 1.0)
    plain, _ = course(0.0, lowest=8.0, highest=512.0, reference=64.0, gather_s=0.0)
    assert large["ttft_p50_s"] > waits
    assert plain["ttft_mean_s"] < large["ttft_mean_s"]


def test_no_site_draws_more_than_its_rating_at_small_batches():
    _, series = course(-1.0)
    assert series.p_kw[:, :3].max() <= 1000.0 + 1e-6


def test_the_energy_is_fitted_to_measured_serving_points():
    # 4 x 441 W at 470 tokens/s with batches of 8, 4 x 589 W at 4,915 tokens/s with 256; two points fit exactly.
    energy = np.array([1764.0 / 470.0, 2356.0 / 4915.0])
    fitted = Batching.fitted((8, 256), energy, reference=64.0)
    c = fitted.batch_energy_share
    e = 1.0 - c + c * 64.0 / np.array([8.0, 256.0])
    np.testing.assert_allclose(e[0] / e[1], energy[0] / energy[1])


@pytest.mark.parametrize(
    ("batch", "energy", "said"),
    [
        ((8,), (1.0,), r"\(1,\) sizes and \(1,\) energies; give two or more of each"),
        ((8, 8), (1.0, 1.0), "give two or more"),
        ((8, 256), (1.0, 2.0), "do not fall towards a limit"),
        ((8, float("nan")), (1.0, 2.0), "not a positive number"),
    ],
)
def test_measurements_that_fit_no_curve_are_refused(batch, energy, said):
    with pytest.raises(ValueError, match=said):
        Batching.fitted(batch, energy)

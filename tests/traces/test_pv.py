"""Generated PV: what its parameters promise, and windows of it in an episode."""

import numpy as np
import pytest

from dcgrid_env import forecast, make_scenario
from dcgrid_env.traces import PvParams, TraceError, generate_pv, pv_rows


def test_same_seed_same_sky_and_another_seed_another():
    first, again, other = generate_pv(300.0, 3), generate_pv(300.0, 3), generate_pv(300.0, 4)
    assert first.power_kw.tobytes() == again.power_kw.tobytes()
    assert not np.array_equal(first.power_kw, other.power_kw)
    assert "seed 3" in str(first.provenance)
    assert first.rated_kw == 1.0


def test_output_lies_between_a_clouds_shade_and_the_clear_sky():
    for seed in range(5):
        share = generate_pv(3600.0, seed).power_kw
        clear = share.max()
        assert 0.75 <= clear <= 1.0
        assert 0.2 * clear - 1e-6 <= share.min() <= 0.6 * clear
        # Both states are there, and the steepest ramp is a cloud of 0.8 in 4 s.
        assert 0.3 < np.mean(share > 0.95 * clear) < 0.9
        assert np.abs(np.diff(share)).max() <= clear * 0.8 * 0.1 / 4.0 + 1e-5


def test_without_clouds_it_is_flat_and_a_lasting_cloud_stays():
    flat = generate_pv(600.0, 0, PvParams(shade=(0.0, 0.0), clear_share=(0.9, 0.9))).power_kw
    np.testing.assert_allclose(flat, 0.9, atol=1e-6)
    dark = PvParams(clear_share=(1.0, 1.0), shade=(0.5, 0.5), sun_mean_s=1.0, cloud_mean_s=1e6, edge_s=(1.0, 1.0))
    assert generate_pv(600.0, 0, dark).power_kw[-1] == pytest.approx(0.5)


def test_a_trace_may_begin_in_the_sun_or_under_a_cloud():
    begins = np.array([generate_pv(1.0, seed).power_kw[0] for seed in range(200)])
    assert 0.2 < np.mean(begins >= 0.75) < 0.8
    assert 0.2 < np.mean(begins < 0.6) < 0.8
    assert begins.min() >= 0.75 * 0.2


def test_splits_share_no_sky():
    rows = [pv_rows(split, 1.0, 600.0, 4) for split in ("train", "validation", "test")]
    assert len({row.tobytes() for split in rows for row in split}) == 12
    assert not rows[0].flags.writeable


@pytest.mark.slow
def test_an_episode_takes_one_window_for_all_inverters():
    scenario = make_scenario(
        "ieee33", inverters={"injection": "pv", "s_rated_kva": (500.0,) * 5 + (250.0,)}, split="test"
    )
    rows = pv_rows("test", 1.0, 3600.0, 24)
    starts = set()
    for seed in range(4):
        share = forecast(scenario, seed).p_inverter_kw / scenario.inverters.parameters.s_rated_kva
        np.testing.assert_allclose(share, share[:, :1] * np.ones(6))
        # Step k takes the k-th second after the window's first.
        windows = np.lib.stride_tricks.sliding_window_view(rows, 120, axis=1)
        at = np.argwhere((np.abs(windows - share[:, 0]) < 1e-12).all(axis=-1))
        assert len(at) >= 1
        starts.add(tuple(at[0]))
    assert len(starts) == 4


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"shade": (0.5, 1.5)}, r"PvParams.shade = \(0.5, 1.5\) is not a rising pair within 0 to 1"),
        ({"shade": 0.5}, "PvParams.shade = 0.5 is not a rising pair"),
        ({"sun_mean_s": (10.0, 50.0)}, r"PvParams.sun_mean_s = \(10.0, 50.0\) is not in 1 to 1e\+06"),
        ({"edge_s": (5.0, 2.0)}, "PvParams.edge_s"),
        ({"sun_mean_s": 0.0}, "PvParams.sun_mean_s = 0.0"),
        ({"clear_share": (float("nan"), 1.0)}, "PvParams.clear_share"),
    ],
)
def test_skies_that_cannot_be(arguments, message):
    with pytest.raises(TraceError, match=message):
        PvParams(**arguments)
    with pytest.raises(TraceError, match="split 'exam' is unknown"):
        pv_rows("exam", 1.0, 600.0, 1)

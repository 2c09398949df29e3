"""Power smoothing: the floor, the ramps and the hysteresis, alone and on training."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from dcgrid_env.traces import AWAKE_SHARE, IDLE_SHARE, TraceError, TrainingParams, generate_training
from dcgrid_env.traces.training.smoothing import PowerSmoothing, smoothed

SHARES = st.floats(IDLE_SHARE, 1.0)


def test_a_job_between_idle_times():
    share = np.full(300, 0.25)
    running = np.zeros(300, dtype=bool)
    running[50:100] = True
    share[50:100] = np.tile([1.0, 0.3], 25)
    drawn = smoothed(share, running, PowerSmoothing(0.6, 1.0, 0.5, 4.0))
    assert (drawn[:50] == 0.25).all()
    # Up by 0.1 a step from the first step of the job on; then half the steps are too short to get far from the floor.
    np.testing.assert_allclose(drawn[50:60], [0.35, 0.45, 0.55, 0.6, 0.7, 0.65, 0.75, 0.7, 0.8, 0.75])
    # The floor holds for 4 s after the last step of the job, and then goes down by 0.05 a step.
    np.testing.assert_allclose(drawn[99:108], 0.95 - 0.05 * np.arange(9).clip(max=7))
    assert (drawn[107:140] == 0.6).all()
    np.testing.assert_allclose(drawn[140:147], 0.55 - 0.05 * np.arange(7))
    np.testing.assert_allclose(drawn[147:], 0.25)


def test_wide_limits_and_the_lowest_floor_change_nothing():
    trace = generate_training(300.0, 3).power_kw
    off = PowerSmoothing(IDLE_SHARE, 1e3, 1e3, 0.0)
    np.testing.assert_array_equal(smoothed(trace, trace > AWAKE_SHARE, off), trace)


@settings(max_examples=100, deadline=None)
@given(
    share=hnp.arrays(np.float64, st.integers(1, 80), elements=SHARES),
    draw=st.data(),
    floor_share=st.floats(IDLE_SHARE, 0.9),
    up=st.floats(1e-3, 1e3),
    down=st.floats(1e-3, 1e3),
    hysteresis_s=st.floats(0.0, 20.0),
)
def test_ramps_and_bounds_hold(share, draw, floor_share, up, down, hysteresis_s):
    running = draw.draw(hnp.arrays(np.bool_, len(share)))
    drawn = smoothed(share, running, PowerSmoothing(floor_share, up, down, hysteresis_s))
    assert drawn.min() >= share.min() - 1e-12
    assert drawn.max() <= max(share.max(), floor_share) + 1e-12
    assert np.diff(drawn).max(initial=0.0) <= up * 0.1 + 1e-12
    assert np.diff(drawn).min(initial=0.0) >= -down * 0.1 - 1e-12


def test_smoothing_of_training_flattens_and_costs_energy_that_does_no_work():
    params = TrainingParams(n_slots=(1, 1), job_mean_s=600.0, gap_mean_s=300.0)
    for seed in range(3):
        plain = generate_training(3600.0, seed, params)
        smooth = generate_training(3600.0, seed, replace(params, smoothing=PowerSmoothing()))
        assert np.abs(np.diff(smooth.power_kw)).max() <= 0.05 + 1e-6
        assert smooth.energy_kws > plain.energy_kws
        assert plain.compute_kw is not None
        assert smooth.compute_kw is not None
        assert (smooth.compute_kw <= plain.compute_kw + 1e-6).all()
        assert (smooth.compute_kw <= smooth.power_kw - IDLE_SHARE + 1e-6).all()
        assert smooth.provenance.parameters["params"]["smoothing"]["floor_share"] == 0.65


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"floor_share": 0.95}, r"PowerSmoothing.floor_share = 0.95 is not in 0.23 to 0.9"),
        ({"ramp_up_share_per_s": 0.0}, r"PowerSmoothing.ramp_up_share_per_s = 0.0"),
        ({"ramp_down_share_per_s": np.nan}, r"PowerSmoothing.ramp_down_share_per_s = nan"),
        ({"hysteresis_s": -1.0}, r"PowerSmoothing.hysteresis_s = -1.0 is not in 0 to 3600"),
    ],
)
def test_bad_settings_are_named(options, message):
    with pytest.raises(TraceError, match=message):
        PowerSmoothing(**options)

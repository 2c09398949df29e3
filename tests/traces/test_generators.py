"""Generated traces: bounds, determinism, and the features that each kind promises."""

import numpy as np
import pytest

from dcgrid_env.traces import (
    AWAKE_SHARE,
    IDLE_SHARE,
    InferenceParams,
    TraceError,
    generate_inference,
    generate_mixed,
    generate_step,
    generate_training,
)

GENERATORS = [generate_inference, generate_training, generate_mixed, generate_step]


@pytest.mark.parametrize("generate", GENERATORS)
def test_same_seed_same_trace_and_another_seed_another(generate):
    first, again, other = generate(120.0, 3), generate(120.0, 3), generate(120.0, 4)
    assert first.power_kw.tobytes() == again.power_kw.tobytes()
    assert not np.array_equal(first.power_kw, other.power_kw)
    assert "seed 3" in str(first.provenance)


@pytest.mark.parametrize("generate", GENERATORS)
@pytest.mark.parametrize("duration_s", [0.05, 1.0, 100.0, 900.0])
def test_bounds_and_duration(generate, duration_s):
    floor = IDLE_SHARE
    if generate is generate_step:
        floor, duration_s = 0.97 * IDLE_SHARE, duration_s + 20.0
    for seed in range(6):
        trace = generate(duration_s, seed)
        assert trace.power_kw.min() >= floor
        assert trace.power_kw.max() <= 1.0
        assert trace.rated_kw == 1.0
        assert duration_s - 1e-9 <= trace.duration_s < duration_s + 0.1


@pytest.mark.parametrize("generate", GENERATORS)
@pytest.mark.parametrize("dt_s", [0.1, 0.3, 1.0, 7.0])
def test_any_step_holds_the_same_energy(generate, dt_s):
    trace = generate(210.0, 5)
    assert trace.resample(dt_s).sum() * dt_s == pytest.approx(trace.energy_kws, rel=1e-9)


@pytest.mark.parametrize("generate", GENERATORS)
@pytest.mark.parametrize(
    ("duration_s", "seed", "message"),
    [(0.0, 1, "duration_s"), (np.nan, 1, "duration_s"), (100.0, -1, "seed = -1"), (100.0, 1.5, "seed = 1.5")],
)
def test_bad_arguments_are_named(generate, duration_s, seed, message):
    with pytest.raises(TraceError, match=message):
        generate(duration_s, seed)


def test_inference_answers_to_its_parameters():
    hours = [generate_inference(3600.0, s).power_kw.mean() for s in range(4)]
    busier = [generate_inference(3600.0, s, InferenceParams(gap_mean_s=40.0)).power_kw.mean() for s in range(4)]
    assert np.mean(busier) > np.mean(hours) + 0.1


def test_inference_idles_between_bursts_and_the_servers_start_together():
    second = np.concatenate([generate_inference(3600.0, s).resample(1.0) for s in range(3)])
    calm = second < 0.3
    assert 0.7 < calm.mean() < 0.95
    # Only a second in which a burst begins or ends may lie between the idle plateau and 0.3.
    assert np.mean(second[calm] <= AWAKE_SHARE + 1e-12) > 0.99
    assert np.diff(second).max() > 0.45


def test_decode_rises_with_the_active_queries():
    # One server without ripple: every level between idle and prefill belongs to one number of active queries.
    params = InferenceParams(n_servers=1, batch=3, followups_per_s=0.0, decode_share=0.7, ripple_share=0.0)
    power = np.concatenate([generate_inference(3600.0, seed, params).power_kw for seed in range(4)])
    plateaus = np.unique(power[(power > AWAKE_SHARE + 1e-6) & (power < 1.0)])
    expected = AWAKE_SHARE + (0.7 - AWAKE_SHARE) * (np.array([1, 2, 3]) / 3) ** params.decode_exponent
    np.testing.assert_allclose(plateaus, expected, atol=1e-6)
    assert power.max() == 1.0


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"n_servers": 0}, "InferenceParams.n_servers = 0"),
        ({"gap_mean_s": 0.0}, "InferenceParams.gap_mean_s"),
        ({"followups_per_s": -1.0}, "InferenceParams.followups_per_s = -1.0"),
        ({"ripple_share": np.nan}, "InferenceParams.ripple_share"),
        ({"token_max_s": 0.001}, "InferenceParams.token_max_s = 0.001 is below"),
        ({"decode_share": 1.2}, "decode_share 1.2"),
    ],
)
def test_bad_inference_parameters_are_named(options, message):
    with pytest.raises(TraceError, match=message):
        InferenceParams(**options)


def test_mixed_holds_all_three_kinds():
    np.testing.assert_array_equal(generate_mixed(300.0, 3).power_kw, generate_inference(300.0, 3).power_kw)
    np.testing.assert_array_equal(generate_mixed(300.0, 4).power_kw, generate_training(300.0, 4).power_kw)
    both = generate_mixed(300.0, 5).power_kw
    training, inference = generate_training(300.0, 5).power_kw, generate_inference(300.0, 5).power_kw
    # One weight, the same at all times, explains the sum.
    weight = np.linalg.lstsq((training - inference)[:, None], both - inference)[0][0]
    assert 0.3 <= weight <= 0.7
    np.testing.assert_allclose(weight * training + (1 - weight) * inference, both, atol=1e-6)


def test_step_is_idle_until_20_s_and_then_exactly_full():
    for dt_s in (0.1, 0.5, 1.0):
        power = generate_step(100.0, 7).resample(dt_s)
        at = round(20.0 / dt_s)
        assert len(power) == round(100.0 / dt_s)
        assert (power[:at] <= IDLE_SHARE).all()
        assert (power[:at] >= 0.97 * IDLE_SHARE).all()
        assert (power[at:] == 1.0).all()


def test_step_at_another_time():
    assert generate_step(10.0, 1, step_s=0.0).resample(1.0).tolist() == [1.0] * 10
    power = generate_step(10.0, 1, step_s=2.5).resample(1.0)
    assert 0.5 < power[2] < 0.7
    assert (power[3:] == 1.0).all()


@pytest.mark.parametrize("step_s", [-1.0, 100.0, np.nan])
def test_step_outside_the_trace_is_named(step_s):
    with pytest.raises(TraceError, match=r"step_s = .* does not lie within the trace of 100 s; give a longer"):
        generate_step(100.0, 1, step_s)

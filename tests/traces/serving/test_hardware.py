"""GPUs, models and replicas against published serving points."""

from dataclasses import replace

import numpy as np
import pytest

from dcgrid_env.traces import GPUS, MODELS, Model, TraceError, replica
from dcgrid_env.traces.serving.hardware import LARGEST_BATCH
from dcgrid_env.traces.serving.pool import decode_share

# Published on H100, requests with prefill and decode mixed: time between tokens, s, and tokens a second.
POINTS = {
    ("llama3-8b", 1, 8): (0.007, 1070.0),
    ("llama3-8b", 1, 256): (0.026, 9010.0),
    ("llama3-70b", 4, 8): (0.017, 470.0),
    ("llama3-70b", 4, 256): (0.040, 4915.0),
}
TOLERANCE = 0.15
# Of the time at batch 256.
IN_PREFILL = 0.25


@pytest.mark.parametrize(("model", "n_gpus", "batch"), POINTS)
def test_published_serving_points(model, n_gpus, batch):
    unit = replica("H100", model)
    between_s, tokens_per_s = POINTS[model, n_gpus, batch]
    assert unit.n_gpus == n_gpus
    assert unit.batch_limit == LARGEST_BATCH
    assert unit.decode_step_s(batch) == pytest.approx(between_s, rel=TOLERANCE)
    answering = 1.0 - IN_PREFILL if batch == LARGEST_BATCH else 1.0
    assert answering * batch / unit.decode_step_s(batch) == pytest.approx(tokens_per_s, rel=TOLERANCE)


def test_published_power_of_a_70b_model_on_four_h100():
    gpu = GPUS["H100"]
    low, high = decode_share(gpu, np.array([8.0, 256.0]))
    assert low == pytest.approx(441.0 / 700.0, abs=0.01)
    assert (1.0 - IN_PREFILL) * high + IN_PREFILL * gpu.prefill_share == pytest.approx(589.0 / 700.0, abs=0.01)


def test_published_power_of_decode_on_an_h200():
    np.testing.assert_allclose(decode_share(GPUS["H200"], np.array([1.0, 256.0])), [0.20, 0.43])


@pytest.mark.parametrize("gpu", GPUS.values(), ids=list(GPUS))
def test_power_rises_with_the_batch_from_idle_to_prefill(gpu):
    share = decode_share(gpu, np.array([0.0, 1.0, 2.0, 32.0, 256.0, 1000.0]))
    assert (np.diff(share) >= 0).all()
    assert gpu.idle_share < share[0] == share[1] == gpu.decode_low_share
    assert share[-2] == share[-1] == gpu.decode_high_share < gpu.prefill_share <= 1.0
    assert gpu.f_min_mhz < gpu.f_max_mhz


@pytest.mark.parametrize(
    ("gpu", "sizes"),
    [
        ("A100", (1, 4, 8, 8, 16)),
        ("H100", (1, 4, 8, 8, 16)),
        ("H200", (1, 2, 4, 4, 8)),
    ],
)
def test_a_replica_is_the_smallest_power_of_two_that_holds_the_weights(gpu, sizes):
    for model, size in zip(MODELS.values(), sizes, strict=True):
        unit = replica(gpu, model.name)
        assert unit.n_gpus == size, model.name
        weights_gb = model.total_b * model.weight_bytes
        assert weights_gb <= 0.8 * size * GPUS[gpu].memory_gb
        assert size == 1 or weights_gb > 0.8 * size / 2 * GPUS[gpu].memory_gb


@pytest.mark.parametrize("gpu", GPUS)
@pytest.mark.parametrize("model", MODELS)
def test_speeds_follow_the_roofline(gpu, model):
    unit = replica(gpu, model)
    kind, net = unit.gpu, unit.model
    # Weights are read at 0.7 of the bandwidth, and a token of the prompt costs two operations a parameter at 0.5.
    weights_gb = net.total_b * net.weight_bytes
    assert unit.weights_s == pytest.approx(weights_gb / (unit.n_gpus * kind.bandwidth_gb_s * 0.7))
    assert unit.prefill_tokens_per_s == pytest.approx(unit.n_gpus * kind.tflops * 1e3 * 0.5 / (2.0 * net.active_b))
    steps_s = [unit.decode_step_s(batch) for batch in (1, 2, 8, 64, 256)]
    assert (np.diff(steps_s) > 0).all()
    # One token reads only what is active; a large batch reads all.
    assert steps_s[0] == pytest.approx(unit.weights_s * net.active_b / net.total_b + unit.request_s)
    assert steps_s[-1] == pytest.approx(unit.weights_s + 256 * unit.request_s, rel=1e-3)
    # A token in a batch is cheaper than alone, and reading is cheaper than answering.
    assert steps_s[-1] / 256 < steps_s[0]
    assert unit.prefill_tokens_per_s > 256 / steps_s[-1]


def test_time_of_a_request_in_full_batches():
    unit = replica("H100", "llama3-70b")
    assert unit.busy_s(14_008.0, 256.0) == pytest.approx(1.0 + unit.decode_step_s(256), rel=1e-3)


def test_the_cache_limits_the_batch():
    small, large = (replica("H100", "llama3-70b", cached_tokens=tokens).batch_limit for tokens in (20_000.0, 5_000.0))
    assert 1 <= small < large < LARGEST_BATCH
    assert small == pytest.approx(large / 4, abs=1)
    assert replica("H100", "llama3-70b", cached_tokens=1e9).batch_limit == 1
    assert replica("H100", "llama3-405b").batch_limit < LARGEST_BATCH


def test_own_gpus_and_models_serve_too():
    gpu = replace(GPUS["H100"], name="mine", memory_gb=160.0)
    assert replica(gpu, MODELS["llama3-70b"]).n_gpus == 2
    assert gpu.site_kw == pytest.approx(1.05)


def test_what_does_not_fit_or_is_unknown_is_named():
    huge = Model("huge", 5000.0, 5000.0, 2.0, 1e5)
    with pytest.raises(TraceError, match=r"model 'huge' of 10000 GB does not fit on 64 H100; choose a larger GPU"):
        replica("H100", huge)
    with pytest.raises(TraceError, match=r"gpu 'T4' is unknown; choose one of A100, H100, H200"):
        replica("T4", "llama3-8b")
    with pytest.raises(TraceError, match=r"model 'gpt' is unknown; choose one of llama3-8b, llama3-70b, llama3-405b"):
        replica("H100", "gpt")

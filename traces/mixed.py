"""Generated power of sites of several kinds, in turn: inference, training, and both on one site."""

from functools import partial

import numpy as np

from dcgrid_env.traces.inference import InferenceParams, generate_inference
from dcgrid_env.traces.provenance import generated
from dcgrid_env.traces.time_grid import as_trace, stream
from dcgrid_env.traces.trace import PowerTrace
from dcgrid_env.traces.training.training_site import TrainingParams, generate_training


def generate_mixed(
    duration_s: float, seed: int, inference: InferenceParams | None = None, training: TrainingParams | None = None
) -> PowerTrace:
    """Generate an inference site, a training site, or the sum of one of each, by seed modulo 3.

    In a sum, training holds 30 to 70 % of the rating. Result and errors are those of `generate_inference`.
    """
    rng = stream("mixed", seed)
    kind = seed % 3
    weight = (0.0, 1.0, rng.uniform(0.3, 0.7))[kind]
    inference, training = inference or InferenceParams(), training or TrainingParams()
    share = compute = 0.0
    parts = (
        (1.0 - weight, partial(generate_inference, params=inference)),
        (weight, partial(generate_training, params=training)),
    )
    for weight, generate in parts:
        if weight:
            part = generate(duration_s, seed)
            assert part.compute_kw is not None
            share, compute = share + weight * part.power_kw[:-1], compute + weight * part.compute_kw[:-1]
    provenance = generated("mixed", seed, duration_s, inference=inference, training=training)
    return as_trace(np.asarray(share), np.asarray(compute), f"mixed-{seed}", provenance)

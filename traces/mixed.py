"""Generated power of sites of several kinds: inference, training, and both under one roof, in turn."""

import numpy as np

from dcgrid_env.traces.grid import as_trace, stream
from dcgrid_env.traces.inference import generate_inference
from dcgrid_env.traces.trace import PowerTrace
from dcgrid_env.traces.training import generate_training


def generate_mixed(duration_s: float, seed: int) -> PowerTrace:
    """Generate an inference site, a training site, or the sum of one of each, by seed modulo 3.

    In a sum, training holds 30 to 70 % of the rating. Arguments, result and errors are those of `generate_inference`.
    """
    rng = stream("mixed", seed)
    kind = seed % 3
    training = (0.0, 1.0, rng.uniform(0.3, 0.7))[kind]
    share = compute = 0.0
    for weight, generate in ((1.0 - training, generate_inference), (training, generate_training)):
        if weight:
            part = generate(duration_s, seed)
            assert part.compute_kw is not None
            share, compute = share + weight * part.power_kw[:-1], compute + weight * part.compute_kw[:-1]
    return as_trace(np.asarray(share), np.asarray(compute), "mixed", seed)

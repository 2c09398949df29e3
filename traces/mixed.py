"""Generated power of sites of several kinds: inference, training, and both under one roof, in turn."""

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
    if kind == 0:
        share = generate_inference(duration_s, seed).power_kw
    elif kind == 1:
        share = generate_training(duration_s, seed).power_kw
    else:
        training = rng.uniform(0.3, 0.7)
        inference_kw = generate_inference(duration_s, seed).power_kw
        share = training * generate_training(duration_s, seed).power_kw + (1 - training) * inference_kw
    return as_trace(share[:-1], "mixed", seed)

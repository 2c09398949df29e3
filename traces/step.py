"""The load step of Chen and Zhang's Fig. 3 (arXiv 2507.06416): idle, then the full rating to the end."""

import math

import numpy as np

from dcgrid_env.traces.checks import TraceError, require_positive
from dcgrid_env.traces.provenance import generated
from dcgrid_env.traces.time_grid import IDLE_SHARE, rounded, stream
from dcgrid_env.traces.trace import PowerTrace


def generate_step(duration_s: float, seed: int, step_s: float = 20.0) -> PowerTrace:
    """Generate a site that idles until `step_s` and then draws exactly its rating.

    Parameters
    ----------
    duration_s : length, s.
    seed : integer of at least 0. It sets the ripple of the idle draw, uniform in 0.97 to 1 of the floor each second,
        so all traces differ.
    step_s : time of the step, s; at least 0 and before the end.

    Returns
    -------
    PowerTrace in share of a rating of 1 kW, with a sample at each second before the step and one at the step

    Raises
    ------
    TraceError
        If the duration, the seed or the time of the step is out of range.
    """
    duration_s = require_positive(duration_s, "duration_s", "give the length of the trace in seconds")
    if not 0 <= step_s < duration_s:
        raise TraceError(
            f"step_s = {step_s!r} does not lie within the trace of {duration_s:g} s; give a longer duration_s"
        )
    rng = stream("step", seed)
    idle_s = np.arange(math.ceil(step_s), dtype=np.float64)
    idle = IDLE_SHARE * rng.uniform(0.97, 1.0, len(idle_s))
    time_s = np.concatenate([idle_s, [step_s, duration_s]])
    share = np.concatenate([rounded(idle), [1.0, 1.0]])
    # The step is taken for work that follows the clock, as the paper has it for all work.
    compute = np.maximum(share - IDLE_SHARE, 0.0)
    provenance = generated("step", seed, duration_s, step_s=step_s)
    return PowerTrace(time_s, share, f"step-{seed}", provenance, compute, rated_kw=1.0)

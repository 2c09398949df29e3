"""Generated power of a site that trains one large model at a time, all GPUs in step.

A job is a row of iterations. Each computes near the rating and then exchanges gradients near idle, at 0.2 to 3 Hz
(arXiv 2508.14318); every some minutes an exchange is prolonged by the writing of a checkpoint. A job begins with the
loading of data and ends at once; between jobs the site idles. Levels, shares and lengths that the source does not
give are choices, not measurements; they stand in `TrainingParams`.
"""

from dataclasses import dataclass, fields

import numpy as np

from dcgrid_env.traces.grid import GRID_S, IDLE_SHARE, as_trace, grid_steps, idle_draw, stream
from dcgrid_env.traces.trace import PowerTrace, TraceError, require_positive


@dataclass(frozen=True)
class TrainingParams:
    """What training jobs are like; pairs are the range from which each job draws, shares are of the rating.

    A field that is out of its range raises TraceError.
    """

    job_mean_s: float = 1800.0
    gap_mean_s: float = 180.0
    loading_s: tuple[float, float] = (5.0, 30.0)
    iteration_hz: tuple[float, float] = (0.2, 3.0)  # drawn evenly in its logarithm
    exchange_fraction: tuple[float, float] = (0.1, 0.3)  # of an iteration
    compute_share: tuple[float, float] = (0.9, 1.0)
    exchange_share: tuple[float, float] = (0.28, 0.4)
    checkpoint_every_s: tuple[float, float] = (200.0, 600.0)
    checkpoint_s: tuple[float, float] = (3.0, 15.0)
    iteration_spread: float = 0.02  # standard deviation of an iteration's length over its mean

    def __post_init__(self) -> None:
        for field in fields(self):
            value = getattr(self, field.name)
            if isinstance(value, tuple):
                low, high = value
                ceiling = 1.0 if field.name.endswith(("_share", "_fraction")) else np.inf
                if not 0 < low <= high <= ceiling:
                    raise TraceError(
                        f"TrainingParams.{field.name} = {value} is not a rising pair above 0 and at most {ceiling:g}"
                    )
        for name in ("job_mean_s", "gap_mean_s"):
            require_positive(getattr(self, name), f"TrainingParams.{name}", "give a time in seconds")
        if not 0 <= self.iteration_spread <= 0.2:
            raise TraceError(f"TrainingParams.iteration_spread = {self.iteration_spread} is not in 0 to 0.2")


def generate_training(duration_s: float, seed: int, params: TrainingParams | None = None) -> PowerTrace:
    """Generate the power of a training site as a share of its rating.

    Parameters
    ----------
    duration_s : length, s; rounded up to the grid of 0.1 s.
    seed : integer of at least 0; the same seed is the same trace.
    params : the jobs.

    Returns
    -------
    PowerTrace with power in [0.23, 1] of a rating of 1 kW, on a grid of 0.1 s

    Raises
    ------
    TraceError
        If the duration or the seed is out of range.
    """
    params = params or TrainingParams()
    n_steps = grid_steps(duration_s)
    end_s = n_steps * GRID_S
    rng = stream("training", seed)
    idle = idle_draw(rng, n_steps)
    # Lengths of jobs and gaps are exponential, so a trace may begin in the middle of either.
    in_job = rng.random() < params.job_mean_s / (params.job_mean_s + params.gap_mean_s)
    time_s, begun_before = 0.0, True
    edges, levels = [], []
    while time_s < end_s:
        length_s = rng.exponential(params.job_mean_s if in_job else params.gap_mean_s)
        if in_job:
            edge_s, level = _job(rng, min(length_s, end_s - time_s), begun_before, params)
            edges.append(time_s + edge_s)
            levels.append(level)
        else:
            edges.append([time_s])
            levels.append([0.0])
        time_s, in_job, begun_before = time_s + length_s, not in_job, False
    edge_s, level = np.append(np.concatenate(edges), end_s), np.append(np.concatenate(levels), 0.0)
    kept = np.diff(edge_s, append=np.inf) > 0
    share = PowerTrace(edge_s[kept], level[kept], "training").resample(GRID_S)
    # Steps that hold any idle time take the idle draw for that part by being at least as high.
    return as_trace(np.maximum(share, idle), np.maximum(share - IDLE_SHARE, 0.0), "training", seed, params)


def _job(rng: np.random.Generator, length_s: float, begun_before: bool, params: TrainingParams):
    """Edges (n,), s from the job's start, and the level (n,) that each begins, share of rating."""
    low_hz, high_hz = np.log(params.iteration_hz)
    period_s = float(np.exp(-rng.uniform(low_hz, high_hz)))
    exchange = rng.uniform(*params.exchange_fraction)
    compute_share, exchange_share = rng.uniform(*params.compute_share), rng.uniform(*params.exchange_share)
    loading_s = 0.0 if begun_before else rng.uniform(*params.loading_s)
    every = max(1, round(rng.uniform(*params.checkpoint_every_s) / period_s))

    n = int(length_s / (period_s * (1 - 4 * params.iteration_spread))) + 2
    step_s = period_s * (1 + params.iteration_spread * rng.standard_normal(n).clip(-4, 4))
    computing_s = (1 - exchange) * step_s
    saved = (np.arange(n) + rng.integers(every)) % every == every - 1
    step_s = step_s + np.where(saved, rng.uniform(*params.checkpoint_s, n), 0.0)
    begin_s = loading_s + np.concatenate([[0.0], np.cumsum(step_s[:-1])])

    edge_s = np.column_stack([begin_s, begin_s + computing_s]).ravel()
    level = np.tile([compute_share, exchange_share], n)
    if loading_s:
        edge_s, level = np.append(0.0, edge_s), np.append(exchange_share, level)
    within = edge_s < length_s
    return edge_s[within], level[within]

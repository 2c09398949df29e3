"""The waveform of one training job: the same for all of its GPUs, which work in step.

A run is loading, a ramp, and then iterations: compute near the rating, exchange of gradients near idle. Now and then
the data for an iteration come late and the GPUs wait (a stall), and every so many iterations the exchange is prolonged
by the writing of a checkpoint. A failure ends a run; the next run of the job loads and ramps again.
"""

from typing import NamedTuple

import numpy as np

from dcgrid_env.traces.checks import FloatArray
from dcgrid_env.traces.time_grid import GRID_S
from dcgrid_env.traces.training.params import TrainingParams

# Iterations are no shorter or longer than this many standard deviations.
_SPREADS = 3.0


class TrainingJob(NamedTuple):
    """Parameters that all runs of a job share; shares are of the rating."""

    period_s: float
    exchange_fraction: float
    compute_share: float
    exchange_share: float
    waiting_share: float
    checkpoint_every: int
    """Iterations."""
    stall_chance: float
    """Chance that an iteration stalls."""


def draw_job(rng: np.random.Generator, params: TrainingParams) -> TrainingJob:
    """Draw what a job is like."""
    period_s = 1.0 / float(_log_uniform(rng, params.iteration_hz))
    return TrainingJob(
        period_s,
        rng.uniform(*params.exchange_fraction),
        rng.uniform(*params.compute_share),
        rng.uniform(*params.exchange_share),
        rng.uniform(*params.waiting_share),
        max(1, round(rng.uniform(*params.checkpoint_every_s) / period_s)),
        min(1.0, period_s / float(_log_uniform(rng, params.stall_every_s))),
    )


def run_edges(
    rng: np.random.Generator, job: TrainingJob, length_s: float, under_way: bool, params: TrainingParams
) -> tuple[FloatArray, FloatArray]:
    """One run of a job, from its start to its end or failure.

    Parameters
    ----------
    length_s : length of the run, s.
    under_way : whether the run began earlier, so that loading and ramp are over and a checkpoint may be near.

    Returns
    -------
    Edges (n,) float64, rising from 0 and below length_s, s from the run's start, and the level (n,) float64 that each
    begins, share of rating
    """
    if under_way:
        begin_s, done = 0.0, int(rng.integers(job.checkpoint_every))
    else:
        begin_s, done = rng.uniform(*params.loading_s), 0
    edge_s, level = _iterations(rng, job, length_s - begin_s, done, params)
    if not under_way:
        edge_s, level = _ramped(edge_s, level, rng.uniform(*params.ramp_s), job.waiting_share)
        edge_s, level = np.append(0.0, begin_s + edge_s), np.append(job.waiting_share, level)
    within = edge_s < length_s
    return edge_s[within], level[within]


def _iterations(rng: np.random.Generator, job: TrainingJob, length_s: float, done: int, params: TrainingParams):
    """Edges (m,), s from 0 on, and levels (m,) of at least one iteration, `done` of them after a checkpoint."""
    n = max(1, int(length_s / (job.period_s * (1 - _SPREADS * params.iteration_spread))) + 1)
    step_s = job.period_s * (1 + params.iteration_spread * rng.standard_normal(n).clip(-_SPREADS, _SPREADS))
    stalled, saved = rng.random(n) < job.stall_chance, (done + np.arange(1, n + 1)) % job.checkpoint_every == 0
    stall_s, saving_s = np.zeros(n), np.zeros(n)
    stall_s[stalled] = _log_uniform(rng, params.stall_s, int(np.count_nonzero(stalled)))
    saving_s[saved] = rng.uniform(*params.checkpoint_s, np.count_nonzero(saved))

    end_s = np.cumsum(stall_s + step_s + saving_s)
    begin_s = np.append(0.0, end_s[:-1])
    compute_s = begin_s + stall_s
    edge_s = np.column_stack([begin_s, compute_s, compute_s + (1 - job.exchange_fraction) * step_s])
    level = np.tile([job.waiting_share, job.compute_share, job.exchange_share], (n, 1))
    present = np.column_stack([stalled, np.ones((n, 2), dtype=bool)])
    return edge_s[present], level[present]


def _ramped(edge_s: FloatArray, level: FloatArray, ramp_s: float, from_share: float) -> tuple[FloatArray, FloatArray]:
    """Let the levels, (m,), rise from `from_share` in a straight line over the first `ramp_s`, in steps of the grid."""
    n_steps = max(1, round(ramp_s / GRID_S))
    head = int(np.searchsorted(edge_s, ramp_s))
    ramp_edge_s = np.union1d(edge_s[:head], np.linspace(0.0, ramp_s, n_steps + 1))
    level_before = level[np.searchsorted(edge_s, ramp_edge_s, side="right") - 1]
    risen = np.minimum(1.0, (ramp_edge_s + 0.5 * ramp_s / n_steps) / ramp_s)
    ramp_level = from_share + (level_before - from_share) * risen
    rest = edge_s > ramp_s
    return np.append(ramp_edge_s, edge_s[rest]), np.append(ramp_level, level[rest])


def _log_uniform(rng: np.random.Generator, bounds: tuple[float, float], shape: int | tuple[()] = ()) -> FloatArray:
    """Draw evenly in the logarithm."""
    low, high = np.log(bounds)
    return np.exp(rng.uniform(low, high, shape))

"""Generated power of a site that trains large models: a few jobs in parallel, all GPUs of a job in step.

The site is cut into slots. Each runs one job after another with idle time between; a job may fail, which drops it to
idle at once, and goes on after a restart. A job computes near the rating and exchanges gradients near idle, at 0.2 to
3 Hz (arXiv 2508.14318). `waveform.py` contains the waveform, `params.py` the numbers and their sources.
No recording was available for calibration.
"""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from dcgrid_env.traces.checks import FloatArray
from dcgrid_env.traces.provenance import generated
from dcgrid_env.traces.time_grid import GRID_S, IDLE_SHARE, as_trace, grid_steps, idle_draw, stream
from dcgrid_env.traces.trace import PowerTrace
from dcgrid_env.traces.training.params import TrainingParams
from dcgrid_env.traces.training.smoothing import smoothed
from dcgrid_env.traces.training.waveform import TrainingJob, draw_job, run_edges


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
    rng = stream("training", seed)
    idle = idle_draw(rng, n_steps)
    low, high = params.n_slots
    n_slots = int(rng.integers(low, high + 1))
    sizes = rng.dirichlet(np.full(n_slots, params.slot_evenness))
    share, compute = np.zeros(n_steps), np.zeros(n_steps)
    for size, slot_rng in zip(sizes, rng.spawn(n_slots), strict=True):
        slot_share, slot_compute = _slot(slot_rng, idle, params)
        share += size * slot_share
        compute += size * slot_compute
    return as_trace(share, compute, f"training-{seed}", generated("training", seed, duration_s, params=params))


class _Run(NamedTuple):
    """A stretch of time in which a job runs without a failure."""

    begin_s: float
    end_s: float
    job: TrainingJob
    under_way: bool


def _slot(rng: np.random.Generator, idle: FloatArray, params: TrainingParams) -> tuple[FloatArray, FloatArray]:
    """Draw of a slot and its compute part, (n_steps,) each, share of the slot's rating."""
    n_steps = len(idle)
    runs = list(_runs(rng, n_steps * GRID_S, params))
    pieces = [run_edges(rng, run.job, run.end_s - run.begin_s, run.under_way, params) for run in runs]
    edges, levels = [], []
    for run, (edge_s, level) in zip(runs, pieces, strict=True):
        edges += [run.begin_s + edge_s, [run.end_s]]
        levels += [level, [0.0]]
    drawn = _means(edges, levels, n_steps)
    running = _means([run[:2] for run in runs], [(1.0, 0.0)] * len(runs), n_steps)
    share, compute = drawn + (1.0 - running) * idle, drawn - running * IDLE_SHARE
    if params.smoothing is not None:
        share = smoothed(share, running > 0, params.smoothing)
        # What the floor adds does no work.
        compute = np.minimum(compute, share - IDLE_SHARE)
    return share, compute


def _runs(rng: np.random.Generator, end_s: float, params: TrainingParams) -> Iterator[_Run]:
    """Runs of a slot's jobs one after another, within 0 to end_s.

    Running time, gaps and times between failures are exponential, so time zero may fall in the middle of any.
    """
    down_s = sum(params.restart_s) / 2
    job_s = params.job_mean_s * (1 + down_s / params.failure_mean_s)
    time_s, under_way = 0.0, False
    if rng.random() >= job_s / (job_s + params.gap_mean_s):
        time_s = rng.exponential(params.gap_mean_s)
    elif rng.random() < down_s / (down_s + params.failure_mean_s):
        time_s = rng.random() * rng.uniform(*params.restart_s)
    else:
        under_way = True
    while time_s < end_s:
        job, left_s = draw_job(rng, params), rng.exponential(params.job_mean_s)
        while left_s > 0 and time_s < end_s:
            run_s = min(left_s, rng.exponential(params.failure_mean_s))
            yield _Run(time_s, min(time_s + run_s, end_s), job, under_way)
            time_s, left_s, under_way = time_s + run_s, left_s - run_s, False
            if left_s > 0:
                time_s += rng.uniform(*params.restart_s)
        time_s += rng.exponential(params.gap_mean_s)


def _means(edges: list, levels: list, n_steps: int) -> FloatArray:
    """Exact means (n_steps,) on the grid of pieces of edges, s, and the levels that they begin; 0 before the first."""
    end_s = n_steps * GRID_S
    edge_s = np.concatenate([[0.0], *edges, [end_s]]).clip(max=end_s)
    level = np.concatenate([[0.0], *levels, [0.0]])
    # Of edges at one time, the last holds.
    lasting = np.diff(edge_s, append=np.inf) > 0
    return PowerTrace(edge_s[lasting], level[lasting], "training").resample(GRID_S)

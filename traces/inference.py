"""Generated power of a site of servers that answer queries to a large language model.

Demand has two states. It is calm, with no query at all, for an exponential time; then a burst hands every server a
batch of queries at once, with a few follow-ups while it lasts. A query is first read (prefill), near the rating, for a
time set by the context's length. It is then answered (decode), at a plateau that rises slowly with the number of active
queries, for a time set by the answer's length. Most answers of a batch end at the cap on their length, so a burst ends
as sharply as it began.

Sources: lengths of contexts and of follow-up answers are the log-normal fits to the Azure 2023 conversation trace
(Splitwise, ISCA 2024). The exponent 0.12 of the plateau fits the median H100 serving power of 0.61, 0.67, 0.82 and
0.84 of rated at batch 8, 32, 128 and 256, over an idle 0.15. The time between tokens, 21 to 27 ms, lies within the 17
to 40 ms of a 70B model. Gap, cap, levels and ripple are calibrated on the recording of Chen and Zhang (arXiv
2507.06416); `python -m docs.studies.traces.generated_inference` shows how well.
"""

import math
from dataclasses import dataclass, fields

import numpy as np

from dcgrid_env.traces.checks import FloatArray, TraceError, require_positive
from dcgrid_env.traces.provenance import generated
from dcgrid_env.traces.time_grid import AWAKE_SHARE, GRID_S, IDLE_SHARE, as_trace, grid_steps, idle_draw, stream
from dcgrid_env.traces.trace import PowerTrace

# The state at time zero has forgotten the calm start this long before.
_WARM_UP_S = 100.0

_POSITIVE = ("n_servers", "batch", "answer_cap_tokens", "gap_mean_s", "prefill_tokens_per_s", "token_min_s")


@dataclass(frozen=True)
class InferenceParams:
    """Parameters of a site of inference servers; shares are of the rating.

    A field that is out of its range raises TraceError.
    """

    n_servers: int = 4
    gap_mean_s: float = 160.0
    batch: int = 8
    followups_per_s: float = 0.15  # for each server, during a burst
    dispatch_mean_s: float = 0.1  # delay of a query of the batch
    context_log_mean: float = 6.63  # of tokens
    context_log_std: float = 0.99
    prefill_tokens_per_s: float = 6000.0
    token_min_s: float = 0.021  # time between tokens, drawn for each burst
    token_max_s: float = 0.027
    answer_cap_tokens: int = 1024
    answer_log_mean: float = 7.3  # of tokens, queries of the batch
    answer_log_std: float = 0.5
    followup_log_mean: float = 5.02  # of tokens
    followup_log_std: float = 0.86
    prefill_share: float = 1.0
    decode_share: float = 0.81  # plateau of a server with a full batch
    decode_exponent: float = 0.12
    ripple_share: float = 0.19  # each server's plateau moves by up to this within 0.1 s

    def __post_init__(self) -> None:
        for field in fields(self):
            value = getattr(self, field.name)
            if field.name in _POSITIVE:
                require_positive(value, f"InferenceParams.{field.name}", "give a value above 0")
            if not (math.isfinite(value) and value >= 0):
                raise TraceError(f"InferenceParams.{field.name} = {value} is not a finite number of at least 0")
        if self.token_max_s < self.token_min_s:
            raise TraceError(
                f"InferenceParams.token_max_s = {self.token_max_s} is below token_min_s {self.token_min_s}"
            )
        if not AWAKE_SHARE <= self.decode_share <= self.prefill_share <= 1.0:
            raise TraceError(
                f"InferenceParams: decode_share {self.decode_share} and prefill_share {self.prefill_share} must rise "
                f"from the idle {AWAKE_SHARE} to at most 1"
            )


def generate_inference(duration_s: float, seed: int, params: InferenceParams | None = None) -> PowerTrace:
    """Generate the power of an inference site as a share of its rating.

    Parameters
    ----------
    duration_s : length, s; rounded up to the grid of 0.1 s.
    seed : integer of at least 0; the same seed is the same trace.
    params : the site; by default one that resembles the recording.

    Returns
    -------
    PowerTrace with power in [0.23, 1] of a rating of 1 kW, on a grid of 0.1 s

    Raises
    ------
    TraceError
        If the duration or the seed is out of range.
    """
    params = params or InferenceParams()
    n_steps = grid_steps(duration_s)
    rng = stream("inference", seed)
    idle = idle_draw(rng, n_steps)
    start_s, token_s = _bursts(rng, n_steps * GRID_S, params)
    share, compute = np.zeros(n_steps), np.zeros(n_steps)
    for _ in range(params.n_servers):
        server, reading = _server(rng, idle, *_queries(rng, start_s, token_s, params), params)
        share += server
        compute += np.where(reading, server - IDLE_SHARE, 0.0)
    return as_trace(
        share / params.n_servers,
        compute / params.n_servers,
        f"inference-{seed}",
        generated("inference", seed, duration_s, params=params),
    )


def _bursts(rng: np.random.Generator, end_s: float, params: InferenceParams) -> tuple[FloatArray, FloatArray]:
    """Start (n_burst,) of the bursts, s, the same at all servers, and their time between tokens (n_burst,), s."""
    bursts, time_s = [], -_WARM_UP_S
    while (time_s := time_s + rng.exponential(params.gap_mean_s)) < end_s:
        token_s = rng.uniform(params.token_min_s, params.token_max_s)
        bursts.append((time_s, token_s))
        time_s += params.answer_cap_tokens * token_s
    table = np.array(bursts).reshape(-1, 2)
    return table[:, 0], table[:, 1]


def _queries(rng: np.random.Generator, start_s: FloatArray, token_s: FloatArray, params: InferenceParams):
    """Queries of one server: arrival, end of prefill and end of answer, (n_query,) each, s."""
    n_burst = len(start_s)
    cap_s = params.answer_cap_tokens * token_s
    n_followups = rng.poisson(params.followups_per_s * cap_s)
    in_batch = np.repeat(np.arange(n_burst), params.batch)
    followup = np.repeat(np.arange(n_burst), n_followups)
    batch_s = start_s[in_batch] + rng.exponential(params.dispatch_mean_s, len(in_batch))
    # Follow-ups come in the first three quarters, so that few outlast the batch.
    followup_s = start_s[followup] + rng.random(len(followup)) * 0.75 * cap_s[followup]
    answer = rng.lognormal(params.answer_log_mean, params.answer_log_std, len(in_batch))
    reply = rng.lognormal(params.followup_log_mean, params.followup_log_std, len(followup))

    burst = np.concatenate([in_batch, followup])
    arrival_s = np.concatenate([batch_s, followup_s])
    tokens = np.minimum(np.concatenate([answer, reply]), params.answer_cap_tokens)
    context = rng.lognormal(params.context_log_mean, params.context_log_std, len(burst))
    prefill_end_s = arrival_s + context / params.prefill_tokens_per_s
    # The cap holds for reading and answering together, so that a batch ends as one, as in the recording.
    end_s = np.minimum(prefill_end_s + tokens * token_s[burst], arrival_s + cap_s[burst])
    return arrival_s, np.minimum(prefill_end_s, end_s), end_s


def _server(rng, idle: FloatArray, arrival_s, prefill_end_s, end_s, params: InferenceParams):
    """Draw (n_steps,) of one server as a share of its rating, and whether it reads, (n_steps,) bool."""
    reading = _count_between(arrival_s, prefill_end_s, len(idle))
    active = _count_between(arrival_s, end_s, len(idle))
    # Follow-ups fill a server beyond its batch, but not past the top of the plateau.
    rise = np.minimum((active / params.batch) ** params.decode_exponent, 1.2)
    plateau = AWAKE_SHARE + (params.decode_share - AWAKE_SHARE) * rise
    plateau += rng.uniform(-params.ripple_share, params.ripple_share, len(idle))
    busy = np.where(reading > 0, params.prefill_share, np.clip(plateau, idle, params.prefill_share))
    return np.where(active > 0, busy, idle), reading > 0


def _count_between(begin_s: FloatArray, end_s: FloatArray, n_steps: int) -> np.ndarray:
    """How many of the intervals each step of the grid falls into, (n_steps,) int; each lasts at least one step."""
    begin = np.floor(begin_s / GRID_S).astype(np.int64)
    end = np.maximum(np.floor(end_s / GRID_S).astype(np.int64), begin + 1)
    change = np.bincount(begin.clip(0, n_steps), minlength=n_steps + 1)
    change = change - np.bincount(end.clip(0, n_steps), minlength=n_steps + 1)
    return np.cumsum(change)[:n_steps]

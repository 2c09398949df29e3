"""A serving model, which computes power and waiting times from requests.

A pool of equal replicas serves requests by continuous batching (`kernel`), at speeds and power of `hardware`.
Nothing is lost: a request is waiting, in a batch, or answered. Power above idle, as a share of the GPUs' rated power:

    dynamic = (reading (prefill - idle) + answering (decode(batch) - idle)) / replicas
    compute = reading (prefill - idle) / replicas                    the part whose speed follows the clock

with the numbers of replicas that read and answer, on average over a step of 0.1 s.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import asdict, replace
from numbers import Integral
from typing import NamedTuple

import numpy as np

from dcgrid_env.traces.checks import FloatArray, TraceError
from dcgrid_env.traces.serving.hardware import LARGEST_BATCH, Gpu, Replica
from dcgrid_env.traces.serving.requests import IntArray, Requests
from dcgrid_env.traces.time_grid import GRID_S, IDLE_SHARE, as_trace, grid_steps
from dcgrid_env.traces.trace import PowerTrace, RequestTimes

# Steps of the grid served at once: bounds what is held.
_CHUNK = 3000


class Served(NamedTuple):
    """What became of requests; arrays (n,) in the order of arrival, s."""

    trace: PowerTrace
    """Draw as a share of the site's rating, over the time in which the requests arrived."""
    time_to_first_token_s: FloatArray
    time_per_output_token_s: FloatArray
    """Between tokens, on average; 0 for an answer of one token."""
    end_to_end_s: FloatArray
    queued: int
    """Requests that had come but not been answered when the last arrival time was over; they were served after it."""


class Load(NamedTuple):
    """What a pool does in some steps: shares of the GPUs' rated power above idle, (n_steps,) each, and who left."""

    dynamic: FloatArray
    compute: FloatArray
    done: FloatArray
    """(5, n) of the requests answered: number, then as in RequestTimes. Only numbers that are multiples of the pool's
    `every`."""


class Pool:
    """Replicas that share the requests of a service evenly; it remembers what it has not answered yet.

    It serves all requests and reports on one in `every`.
    """

    def __init__(self, replica: Replica, n_replicas: int, every: int = 1) -> None:
        # Imported late because it brings the compiler with it.
        from dcgrid_env.traces.serving import kernel

        self._kernel = kernel
        self.replica, self.n_replicas, self.every = replica, n_replicas, every
        self._constants = np.array(
            [
                n_replicas,
                replica.batch_limit,
                replica.prefill_tokens_per_s,
                replica.weights_s,
                replica.read_share,
                replica.request_s,
            ]
        )
        self._state, self._count = np.zeros(7), np.zeros(3, dtype=np.int64)
        self._ring = np.zeros(kernel.RING, dtype=np.int64)
        self._table = np.zeros((7, 0))
        self._n_come = 0

    @property
    def waiting(self) -> int:
        """Requests that have come and are not answered."""
        return self._table.shape[1]

    def advance(self, arrival_s: FloatArray, context: IntArray, generated: IntArray, n_steps: int) -> Load:
        """Take the requests that arrive in the next `n_steps` steps of 0.1 s, (n,) each, and serve for as long."""
        longest = int(generated.max(initial=0))
        if longest > self._kernel.RING - 512:
            raise TraceError(
                f"request {self._n_come + int(np.argmax(generated))} has an answer of {longest} tokens, more than the "
                f"{self._kernel.RING - 512} that can be served; cut it"
            )
        kernel, count = self._kernel, self._count
        begin_s, n_old, n_new = self._state[kernel.STEP] * GRID_S, self.waiting, len(arrival_s)
        table = np.zeros((7, n_old + n_new))
        table[:, :n_old] = self._table
        numbers = np.arange(self._n_come, self._n_come + n_new)
        for row, values in enumerate((arrival_s, context, generated, numbers)):
            table[row, n_old:] = values
        self._n_come += n_new
        reading, batch, at_v = np.empty(n_steps), np.empty((n_steps, 2)), np.empty(n_steps + 1)
        kernel.advance(self._constants, self._state, count, self._ring, table, n_steps, reading, batch, at_v)
        done = table[kernel.END_V] <= at_v[-1]
        done[count[kernel.READ] :] = False
        finished = np.flatnonzero(done)
        finished = finished[table[kernel.NUMBER, finished] % self.every == 0]
        rows = [kernel.NUMBER, kernel.ARRIVAL, kernel.CONTEXT, kernel.FIRST, kernel.GENERATED, kernel.END_V]
        number, arrival, context, first_s, tokens, end_v = table[rows][:, finished]
        # The kernel knows to a step when an answer begins; none is faster than an answer in a batch of its own.
        earliest_s = first_s + (tokens - 1.0) * self.replica.decode_step_s(1.0)
        end_s = np.maximum(begin_s + _reached_s(end_v, at_v), earliest_s)
        prefill_s = context / self.replica.prefill_tokens_per_s
        left = np.stack((number, arrival, first_s - arrival, end_s - arrival, prefill_s))
        self._table = table[:, ~done]
        count -= np.count_nonzero(done)
        gpu = self.replica.gpu
        compute = reading * ((gpu.prefill_share - gpu.idle_share) / self.n_replicas)
        above_idle = decode_share(gpu, batch[:, 1]) - gpu.idle_share
        return Load(compute + batch[:, 0] * above_idle / self.n_replicas, compute, left)

    def rest(self) -> Load:
        """Go on for a while without new requests."""
        empty = np.zeros(0, dtype=np.int64)
        return self.advance(empty.astype(np.float64), empty, empty, _CHUNK)


def _reached_s(goal: FloatArray, at_v: FloatArray) -> FloatArray:
    """When V, known at the edges of the steps (n_steps + 1,), first reaches each `goal` (n,), s from the first edge."""
    k = np.searchsorted(at_v, goal).clip(1)
    width = at_v[k] - at_v[k - 1]
    part = np.divide(goal - at_v[k - 1], width, out=np.zeros_like(width), where=width > 0)
    return (k - 1 + part.clip(0.0, 1.0)) * GRID_S


def decode_share(gpu: Gpu, batch: FloatArray) -> FloatArray:
    """Draw of a GPU that answers a batch, as a share of its rated power."""
    rise = np.log(np.clip(batch, 1.0, LARGEST_BATCH)) / np.log(LARGEST_BATCH)
    return gpu.decode_low_share + (gpu.decode_high_share - gpu.decode_low_share) * rise


def in_chunks(
    parts: Iterable[tuple[FloatArray, IntArray, IntArray]], n_steps: int
) -> Iterator[tuple[FloatArray, IntArray, IntArray, int]]:
    """Cut requests that come some at a time into those of each chunk of steps, with the chunk's number of steps."""
    parts = iter(parts)
    waiting = [(np.zeros(0), np.zeros(0, dtype=np.int64), np.zeros(0, dtype=np.int64))]
    more = True
    for begin in range(0, n_steps, _CHUNK):
        end = min(begin + _CHUNK, n_steps)
        while more and not (len(waiting[-1][0]) and waiting[-1][0][-1] >= end * GRID_S):
            part = next(parts, None)
            more = part is not None
            if part is not None:
                waiting.append(part)
        arrival_s, context, generated = (np.concatenate(column) for column in zip(*waiting, strict=True))
        cut = int(np.searchsorted(arrival_s, end * GRID_S, side="left"))
        yield arrival_s[:cut], context[:cut], generated[:cut], end - begin
        waiting = [(arrival_s[cut:], context[cut:], generated[cut:])]


def serve(requests: Requests, replica: Replica, n_replicas: int = 1) -> Served:
    """Serve requests on dedicated replicas, whose GPUs form the site.

    Parameters
    ----------
    requests : at least one.
    replica : a model on its GPUs, see `dcgrid_env.traces.serving.hardware.replica`.
    n_replicas : number of replicas.

    Returns
    -------
    Served; all requests are answered, those that queue at the end after it

    Raises
    ------
    TraceError
        If `requests` is empty or `n_replicas` is below 1.
    """
    if len(requests) == 0 or isinstance(n_replicas, bool) or not isinstance(n_replicas, Integral) or n_replicas < 1:
        raise TraceError(f"{len(requests)} requests and n_replicas = {n_replicas!r}; give at least one of each, whole")
    n_replicas = int(n_replicas)
    pool, n_steps = Pool(replica, n_replicas), grid_steps(requests.duration_s)
    n_steps += bool(requests.arrival_s[-1] >= n_steps * GRID_S)  # a log ends with its last request
    whole = [(requests.arrival_s, requests.context_tokens, requests.generated_tokens)]
    loads = [pool.advance(*chunk) for chunk in in_chunks(whole, n_steps)]
    queued, done = pool.waiting, [load.done for load in loads]
    while pool.waiting:
        done.append(pool.rest().done)
    table = np.concatenate(done, axis=1)
    _, _, first_s, end_s, prefill_s = table[:, np.argsort(table[0])]  # answers end out of order
    dynamic, compute = (np.concatenate([getattr(load, name) for load in loads]) for name in ("dynamic", "compute"))
    served_by = {"replica": asdict(replica), "replicas": n_replicas}
    provenance = requests.provenance
    trace = as_trace(
        *site_shares(replica.gpu, dynamic, compute),
        f"{requests.name} on {n_replicas} x {replica.model.name}",
        replace(provenance, parameters={**provenance.parameters, "served_by": served_by}),
        RequestTimes(requests.arrival_s, first_s, end_s, prefill_s),
    )
    per_token_s = (end_s - first_s) / np.maximum(requests.generated_tokens - 1, 1)
    return Served(trace, first_s, per_token_s, end_s, queued)


def site_shares(gpu: Gpu, dynamic: FloatArray, compute: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Draw of a site, and its compute-bound part, as shares of its rating; arguments as in Load, for all its GPUs.

    The rest of a node (fans, processors, network) follows the GPUs, so that an idle site draws IDLE_SHARE and one whose
    GPUs draw their rated power draws its rating.
    """
    scale = (1.0 - IDLE_SHARE) / (1.0 - gpu.idle_share)
    return IDLE_SHARE + scale * dynamic, scale * compute

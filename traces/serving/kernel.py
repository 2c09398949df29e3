"""One pool of equal replicas with continuous batching, stepped on the grid of 0.1 s; compiled.

Requests wait for a place in a batch, are read (prefill) and answered (decode), first come first served. All replicas of
the pool carry the same load, so the pool has one batch size. A replica that reads does not answer meanwhile. All
requests in decode advance together, by V tokens since the beginning. A request with g tokens whose first came at V0
therefore ends when V reaches V0 + g - 1, and no step needs to visit every request.
"""

from dcgrid_env.core.compiled import compiled
from dcgrid_env.traces.time_grid import GRID_S

RING = 8192
"""Requests in decode are counted by the token at which they end, modulo this: no answer may be longer."""

READ_LEAVES = 0.1
"""Share of a replica's time that reading leaves to answers (chunked prefill)."""

# Places in the state vector.
ADMITTED_TOKENS, READ_TOKENS, V, IN_BATCH, IN_DECODE, STEP, LAST_END_V = range(7)
# Places in the vector of constants.
REPLICAS, BATCH_LIMIT, PREFILL_RATE, WEIGHTS_S, READ_SHARE, REQUEST_S = range(6)
# Rows of the table of requests in the pool.
ARRIVAL, CONTEXT, GENERATED, NUMBER, LEVEL, FIRST, END_V = range(7)
# Places in the counters: how many of the table have come, been admitted, been read.
COME, ADMITTED, READ = range(3)


@compiled(nogil=True)
def advance(constants, state, count, ring, table, n_steps, reading, batch, at_v):
    """Advance by `n_steps`, in place.

    Parameters
    ----------
    constants, state, count, ring : see the names of their places above.
    table : (7, n) float64, requests in the order of arrival; LEVEL, FIRST and END_V are filled in.
    reading : (n_steps,) out, replicas that read, on average over the step.
    batch : (n_steps, 2) out, replicas that answer, on average over the step, and requests in each.
    at_v : (n_steps + 1,) out, V at the edges of the steps.
    """
    replicas, limit, rate = constants[REPLICAS], constants[REPLICAS] * constants[BATCH_LIMIT], constants[PREFILL_RATE]
    dt, n = GRID_S, table.shape[1]
    at_v[0] = state[V]
    for step in range(n_steps):
        begin_s = state[STEP] * dt
        while count[COME] < n and table[ARRIVAL, count[COME]] < begin_s + dt:
            count[COME] += 1
        while count[ADMITTED] < count[COME] and state[IN_BATCH] < limit:
            state[ADMITTED_TOKENS] += table[CONTEXT, count[ADMITTED]]
            table[LEVEL, count[ADMITTED]] = state[ADMITTED_TOKENS]
            count[ADMITTED] += 1
            state[IN_BATCH] += 1.0
        busy = min(replicas, state[IN_BATCH])
        # One replica reads one request at a time, and reading leaves some time to what is being answered.
        readers = min(busy - READ_LEAVES * min(busy, state[IN_DECODE]), float(count[ADMITTED] - count[READ]))
        queued = state[ADMITTED_TOKENS] - state[READ_TOKENS]
        reading[step] = min(queued / (rate * dt), readers)
        tokens = reading[step] * rate * dt
        decoding = min(busy, state[IN_DECODE])
        answering = min(decoding, busy - reading[step])
        size = state[IN_DECODE] / decoding if decoding > 0.0 else 1.0
        step_s = constants[WEIGHTS_S] * (1.0 - (1.0 - constants[READ_SHARE]) ** size) + size * constants[REQUEST_S]
        advanced = answering / decoding * dt / step_s if decoding > 0.0 else 0.0
        end_v = state[V] + advanced
        if decoding > 0.0 and end_v > state[LAST_END_V]:
            # The last answer ends within the step, and nobody is left to answer for the rest of it.
            answering *= (state[LAST_END_V] - state[V]) / advanced
        reached = state[READ_TOKENS] + tokens
        while count[READ] < count[ADMITTED] and table[LEVEL, count[READ]] <= reached + 1e-6:
            i = count[READ]
            part = (table[LEVEL, i] - state[READ_TOKENS]) / (readers * rate * dt) if readers > 0.0 else 1.0
            # A request that came within the step is not read before it came.
            table[FIRST, i] = max(begin_s + part * dt, table[ARRIVAL, i] + table[CONTEXT, i] / rate)
            part = min((table[FIRST, i] - begin_s) / dt, 1.0)
            table[END_V, i] = state[V] + part * advanced + table[GENERATED, i] - 1.0
            ring[int(table[END_V, i]) % len(ring)] += 1
            state[LAST_END_V] = max(state[LAST_END_V], int(table[END_V, i]) + 1.0)
            state[IN_DECODE] += 1.0
            count[READ] += 1
        state[READ_TOKENS] = min(reached, state[ADMITTED_TOKENS])
        for token in range(int(state[V]), int(end_v)):
            ended = ring[token % len(ring)]
            ring[token % len(ring)] = 0
            state[IN_DECODE] -= ended
            state[IN_BATCH] -= ended
        state[V] = end_v
        state[STEP] += 1.0
        batch[step, 0], batch[step, 1] = answering, size
        at_v[step + 1] = state[V]

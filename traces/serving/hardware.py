"""GPUs and language models, and the speed and power of each combination.

A replica is the smallest power of two of GPUs whose memory holds the weights with a fifth to spare. Its speeds follow a
roofline with two efficiencies:

    decode step, s   = weights read / (n bandwidth 0.7) + batch (2 active / (n flops 0.5) + 600 kv / (n bandwidth 0.7))
    weights read     = weights (1 - (1 - active / total)^batch)        all of them but in a mixture of experts
    prefill, tokens/s = n flops 0.5 / (2 active)

with n GPUs in the replica and 600 tokens of context on average (kv: bytes of key and value cache a token). Published
serving points on H100 are 7 and 26 ms between tokens at batch 8 and 256 for an 8B model on one GPU. For a 70B model on
four GPUs they are 17 and 40 ms. The formulas give 7.4, 23.7, 15.8 and 38.7 ms.

Power of a busy GPU as a share of its rated power (TDP):

    prefill: prefill_share        decode: low + (high - low) log(batch) / log(256)

H100: a 70B model on four drew 0.63 at batch 8 and 0.84 at batch 256 (with about a quarter of the time in prefill),
and medians of 0.61, 0.67, 0.82 and 0.84 are published for prefill and decode mixed at batch 8, 32, 128 and 256.
H200: decode alone draws 0.20 to 0.43 (arXiv 2605.11999). A100: idle 0.15, run averages 0.73 to 0.91; the decode range
is a choice within them and the recording of Chen and Zhang (0.6 in bursts). Idle of the H100 and H200 (70 W) is a
choice. Memory, bandwidth and dense 16-bit flops are the makers' data sheets.
"""

from __future__ import annotations

from dataclasses import dataclass

from dcgrid_env.traces.checks import TraceError

BANDWIDTH_EFFICIENCY = 0.7
FLOPS_EFFICIENCY = 0.5
CONTEXT_TOKENS = 600
"""Tokens in the cache of a request, on average, for the cost of attention."""
LARGEST_BATCH = 256
NODE_SHARE = 1.5
"""Rating of a site over the rated power of its GPUs: a node of 8 H100 (5.6 kW) peaks at 8.4 kW (arXiv 2506.14551)."""


@dataclass(frozen=True)
class Gpu:
    """A type of GPU; shares are of its rated power."""

    name: str
    rated_w: float
    memory_gb: float
    bandwidth_gb_s: float
    tflops: float
    f_min_mhz: float
    f_max_mhz: float
    idle_share: float
    decode_low_share: float
    decode_high_share: float
    prefill_share: float

    @property
    def site_kw(self) -> float:
        """Rating of a site for each of its GPUs, kW."""
        return NODE_SHARE * self.rated_w / 1000.0


@dataclass(frozen=True)
class Model:
    """A language model: parameters in thousands of millions, bytes a parameter, bytes of cache a token."""

    name: str
    total_b: float
    active_b: float
    weight_bytes: float
    cache_bytes: float


GPUS: dict[str, Gpu] = {
    gpu.name: gpu
    for gpu in (
        Gpu("A100", 400.0, 80.0, 2039.0, 312.0, 210.0, 1410.0, 0.15, 0.50, 0.75, 0.95),
        Gpu("H100", 700.0, 80.0, 3350.0, 989.0, 210.0, 1980.0, 0.10, 0.53, 0.79, 1.00),
        Gpu("H200", 700.0, 141.0, 4800.0, 989.0, 210.0, 1980.0, 0.10, 0.20, 0.43, 1.00),
    )
}
"""Types of GPU by name."""

# Cache: layers x key-value heads x head size x 2 x 2 bytes; DeepSeek's is compressed to 512 + 64 numbers a layer.
MODELS: dict[str, Model] = {
    model.name: model
    for model in (
        Model("llama3-8b", 8.0, 8.0, 2.0, 32 * 8 * 128 * 4.0),
        Model("llama3-70b", 70.6, 70.6, 2.0, 80 * 8 * 128 * 4.0),
        Model("llama3-405b", 405.0, 405.0, 1.0, 126 * 8 * 128 * 4.0),
        Model("mixtral-8x22b", 141.0, 39.0, 2.0, 56 * 8 * 128 * 4.0),
        Model("deepseek-v3", 671.0, 37.0, 1.0, 61 * 576 * 2.0),
    )
}
"""Language models by name."""


@dataclass(frozen=True)
class Replica:
    """A model on as many GPUs as it needs."""

    gpu: Gpu
    model: Model
    n_gpus: int
    weights_s: float
    """Time to read all weights once, s."""
    request_s: float
    """Time that each request adds to a decode step, s."""
    prefill_tokens_per_s: float
    batch_limit: int

    @property
    def read_share(self) -> float:
        """Share of the weights that one token reads."""
        return self.model.active_b / self.model.total_b

    def decode_step_s(self, batch: float) -> float:
        """Time of one decode step, s, which gives each request of the batch a token."""
        return self.weights_s * (1.0 - (1.0 - self.read_share) ** batch) + batch * self.request_s

    def busy_s(self, context_tokens: float, generated_tokens: float) -> float:
        """Time of a replica that a request takes where batches are full, s."""
        answer_s = generated_tokens * self.decode_step_s(self.batch_limit) / self.batch_limit
        return context_tokens / self.prefill_tokens_per_s + answer_s


def replica(gpu: str | Gpu, model: str | Model, cached_tokens: float = 1500.0) -> Replica:
    """The smallest replica of a model on GPUs of a type; `cached_tokens` a request are held in memory.

    TraceError for an unknown name, or a model that 64 of the GPUs do not hold.
    """
    kind, net = _find("gpu", gpu, GPUS), _find("model", model, MODELS)
    weights_gb = net.total_b * net.weight_bytes
    sizes = [n for n in (1, 2, 4, 8, 16, 32, 64) if weights_gb <= 0.8 * n * kind.memory_gb]
    if not sizes:
        raise TraceError(f"model {net.name!r} of {weights_gb:g} GB does not fit on 64 {kind.name}; choose a larger GPU")
    n = sizes[0]
    bandwidth, flops = n * kind.bandwidth_gb_s * 1e9 * BANDWIDTH_EFFICIENCY, n * kind.tflops * 1e12 * FLOPS_EFFICIENCY
    free_bytes = (0.9 * n * kind.memory_gb - weights_gb) * 1e9
    return Replica(
        kind,
        net,
        n,
        weights_s=weights_gb * 1e9 / bandwidth,
        request_s=2.0 * net.active_b * 1e9 / flops + CONTEXT_TOKENS * net.cache_bytes / bandwidth,
        prefill_tokens_per_s=flops / (2.0 * net.active_b * 1e9),
        batch_limit=max(1, min(LARGEST_BATCH, int(free_bytes / (net.cache_bytes * cached_tokens)))),
    )


def _find(kind: str, name, table: dict):
    if not isinstance(name, str):
        return name
    if name not in table:
        raise TraceError(f"{kind} {name!r} is unknown; choose one of {', '.join(table)}")
    return table[name]

"""Named sources of generated power, each with a shifted variant for tests out of distribution."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

from dcgrid_env.traces.inference import InferenceParams, generate_inference
from dcgrid_env.traces.mixed import generate_mixed
from dcgrid_env.traces.serving.arrivals import Arrivals
from dcgrid_env.traces.serving.services import SERVICES, Service, TokenLaw
from dcgrid_env.traces.serving.site import Site, Tenant, generate_site
from dcgrid_env.traces.step import generate_step
from dcgrid_env.traces.trace import PowerTrace
from dcgrid_env.traces.training.training_site import TrainingParams, generate_training

Generate = Callable[[float, int], PowerTrace]


@dataclass(frozen=True)
class TraceSource:
    """A named generator: `generate(duration_s, seed)` gives a trace in share of rating."""

    name: str
    description: str
    generate: Generate
    shifted: Generate | None
    """The generator of the split `ood`; None if there is none."""
    daily: bool = False
    """Whether demand follows the hour of the day; a trace then begins at hour `seed` modulo 24."""


WAVES = Service(
    "waves",
    Arrivals(3.0, calm_rate=0.1, calm_s=40.0, busy_s=20.0, dwell_shape=25.0),
    context=SERVICES["chat"].context,
    generated=TokenLaw(((1.0, 5.5, 0.8),), 1024),
)
"""Queries that come in waves of about a minute, as from people who run the same task again and again."""


def _task(model: str, gpu: str) -> Generate:
    """Sixteen GPUs that answer waves of queries with one model; the waves are the same for all models."""
    # The load is what gives the rate of the waves on these GPUs.
    unit = Site(gpu, 16, (Tenant(WAVES, model, 1.0, 1.0),), daily_swing=0.0)
    load = WAVES.arrivals.rate_per_s / unit.rate_per_s(unit.tenants[0])
    return partial(generate_site, site=Site(gpu, 16, (Tenant(WAVES, model, 1.0, load),), daily_swing=0.0))


def _service(gpu: str, service: str, load: float) -> Generate:
    return partial(generate_site, site=Site(gpu, 266, (Tenant(service, "llama3-70b", 1.0, load),)))


def _mix(gpu: str, chat: float, code: float, training: float) -> Generate:
    tenants = (Tenant("chat", "llama3-70b", chat, 0.35), Tenant("code", "llama3-70b", code, 0.15))
    return partial(generate_site, site=Site(gpu, 266, tenants, training))


# Another machine and model: more servers, faster tokens, longer answers, a higher plateau.
_OTHER_INFERENCE = InferenceParams(
    n_servers=8,
    gap_mean_s=60.0,
    batch=16,
    prefill_tokens_per_s=14000.0,
    token_min_s=0.012,
    token_max_s=0.018,
    answer_log_mean=6.3,
    decode_share=0.7,
)
# Another cluster: slower iterations that communicate more.
_OTHER_TRAINING = TrainingParams(iteration_hz=(0.05, 0.2), exchange_fraction=(0.3, 0.5))

TRACE_SOURCES: dict[str, TraceSource] = {
    source.name: source
    for source in (
        TraceSource(
            "inference",
            "LLM inference: idle, and bursts of some 25 s near the rating, like the recording of Chen and Zhang",
            generate_inference,
            partial(generate_inference, params=_OTHER_INFERENCE),
        ),
        TraceSource(
            "training",
            "LLM training: near the rating with exchanges near idle at 0.2 to 3 Hz, checkpoints, starts and stops",
            generate_training,
            partial(generate_training, params=_OTHER_TRAINING),
        ),
        TraceSource(
            "mixed",
            "sites of inference, of training, and of both, one in three each",
            generate_mixed,
            partial(generate_mixed, inference=_OTHER_INFERENCE, training=_OTHER_TRAINING),
        ),
        TraceSource(
            "step",
            "idle until 20 s after the row begins, then full: take windows at offset 0 (Chen and Zhang, Fig. 3)",
            generate_step,
            None,
        ),
        TraceSource(
            "chat",
            "request-level chat service: 280 kW of H100 with Llama 3 70B, an hour of the day a row",
            _service("H100", "chat", 0.35),
            _service("H200", "code", 0.12),
            daily=True,
        ),
        TraceSource(
            "code",
            "request-level code completion on the same site: bursts of ten seconds and silence",
            _service("H100", "code", 0.12),
            _service("H200", "chat", 0.35),
            daily=True,
        ),
        TraceSource(
            "site",
            "the same site shared: 40 % of the GPUs for chat, 30 % for code, 30 % in training",
            _mix("H100", 0.4, 0.3, 0.3),
            _mix("H200", 0.2, 0.2, 0.6),
            daily=True,
        ),
        *(
            TraceSource(
                model,
                f"16 H100 that answer waves of queries with {model}, the same waves for every model",
                _task(model, "H100"),
                _task(model, "H200"),
            )
            for model in ("llama3-70b", "llama3-405b", "mixtral-8x22b", "deepseek-v3")
        ),
    )
}
"""Named sources of generated power."""

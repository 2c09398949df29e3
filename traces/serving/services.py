"""Services that send requests to a language model, with the laws of their arrivals and tokens.

| preset | stands for | arrivals | log-normal tokens |
|---|---|---|---|
| `chat` | a production chat service | gamma, two states of similar rate | at most 4,142 in and 601 out |
| `code` | a production code completion service | gamma, bursts and silence | at most 7,437 in and 1,900 out |

Both are fitted to the hour of each in the Azure LLM inference trace 2023 (P. Patel et al., "Splitwise: Efficient
Generative LLM Inference Using Phase Splitting", ISCA 2024; CC-BY 4.0): rate, coefficient of variation of the distances,
Fano factor of counts at 1 s and 60 s, and the 50, 90 and 99 % quantiles of tokens. Mean and standard deviation of the
logarithms themselves (6.63, 0.99 and so on) give medians and tails that are off by up to 26 % and 85 %, because the
services cut contexts and answers at some length; so the laws are fitted to the quantiles and cut there too.
`python -m dcgrid_env.traces.compare_requests` prints how well they do.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import asdict, dataclass, replace
from statistics import NormalDist

import numpy as np

from dcgrid_env.traces.grid import stream
from dcgrid_env.traces.provenance import Provenance
from dcgrid_env.traces.serving.arrivals import Arrivals
from dcgrid_env.traces.serving.requests import IntArray, Requests
from dcgrid_env.traces.trace import FloatArray, TraceError, require_positive


@dataclass(frozen=True)
class TokenLaw:
    """Log-normal numbers of tokens, rounded, at least 1 and at most `most`. Fields out of range raise TraceError."""

    log_mean: float
    log_std: float
    most: int

    def __post_init__(self) -> None:
        require_positive(self.log_std, "TokenLaw.log_std", "give a standard deviation of the logarithm")
        if not (np.isfinite(self.log_mean) and self.most >= 1):
            raise TraceError(f"TokenLaw(log_mean={self.log_mean!r}, most={self.most!r}): give a number, and at least 1")

    def draw(self, rng: np.random.Generator, n: int) -> IntArray:
        """Draw (n,) int64."""
        return np.clip(np.rint(rng.lognormal(self.log_mean, self.log_std, n)), 1, self.most).astype(np.int64)

    @property
    def mean(self) -> float:
        """Mean number of tokens, but for rounding."""
        cdf, edge = NormalDist().cdf, (math.log(self.most) - self.log_mean) / self.log_std
        whole = math.exp(self.log_mean + 0.5 * self.log_std**2)
        return whole * cdf(edge - self.log_std) + self.most * (1.0 - cdf(edge))


@dataclass(frozen=True)
class Service:
    """Requests of one kind."""

    name: str
    arrivals: Arrivals
    context: TokenLaw
    generated: TokenLaw

    def draw(
        self, name: str, seed: int, duration_s: float, begin_s: float = 0.0
    ) -> Iterator[tuple[FloatArray, IntArray, IntArray]]:
        """Yield arrivals in [0, duration_s), s, context tokens and generated tokens, (n,) each, some at a time.

        `name` and `seed` choose the random stream, `begin_s` is the time of day at the beginning, s.
        """
        arrivals, context, generated = stream(name, seed).spawn(3)
        for arrival_s in self.arrivals.draw(arrivals, duration_s, begin_s):
            n = len(arrival_s)
            yield arrival_s, self.context.draw(context, n), self.generated.draw(generated, n)


SERVICES: dict[str, Service] = {
    service.name: service
    for service in (
        Service(
            "chat",
            Arrivals(5.53, shape=0.95, calm_rate=0.59, calm_s=300.0, busy_s=300.0),
            context=TokenLaw(6.80, 0.87, 4142),
            generated=TokenLaw(4.98, 0.84, 601),
        ),
        Service(
            "code",
            Arrivals(2.57, shape=0.4, calm_rate=0.0, calm_s=44.0, busy_s=10.5),
            context=TokenLaw(7.29, 0.985, 7437),
            generated=TokenLaw(2.58, 1.2, 1900),
        ),
    )
}


def find_service(service: str | Service) -> Service:
    """A service by name, or the one given; TraceError for an unknown name, listing those that exist."""
    if isinstance(service, Service):
        return service
    if service not in SERVICES:
        raise TraceError(f"service {service!r} is unknown; choose one of {', '.join(SERVICES)} or give a Service")
    return SERVICES[service]


def requests(
    service: str | Service,
    hours: float = 24.0,
    seed: int = 0,
    *,
    rate_per_s: float | None = None,
    daily_swing: float = 0.0,
    begin_hour: float = 0.0,
) -> Requests:
    """Generate the requests of a service.

    Parameters
    ----------
    service : "chat", "code" or a Service.
    hours : length, h.
    seed : integer of at least 0; the same seed is the same requests.
    rate_per_s : mean rate, 1/s, instead of the service's own; its bursts keep their relative height.
    daily_swing : share by which the rate rises and falls over the day; 0: no daily cycle.
    begin_hour : hour of the day at which it begins.

    Returns
    -------
    Requests with arrival_s, context_tokens and generated_tokens, (n,) each

    Raises
    ------
    TraceError
        For an unknown service or a number out of range.
    """
    service = find_service(service)
    duration_s = 3600.0 * require_positive(hours, "hours", "give the length in hours")
    if not 0.0 <= begin_hour <= 24.0:
        raise TraceError(f"begin_hour = {begin_hour!r} is not an hour of the day, 0 to 24")
    law = replace(service.arrivals, daily_swing=daily_swing)
    if rate_per_s is not None:
        law = replace(law, rate_per_s=require_positive(rate_per_s, "rate_per_s", "give requests a second"))
    service = replace(service, arrivals=law)
    parts = list(service.draw(f"requests {service.name}", seed, duration_s, 3600.0 * begin_hour))
    arrival_s, context, generated = (np.concatenate(column) for column in zip(*parts, strict=True))
    parameters = {**asdict(service), "hours": hours, "begin_hour": begin_hour}
    return Requests(
        arrival_s, context, generated, duration_s, f"{service.name}-{seed}",
        Provenance(f"generator requests {service.name}", int(seed), parameters),
    )  # fmt: skip

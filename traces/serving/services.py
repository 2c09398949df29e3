"""Services that send requests to a language model, with the laws of their arrivals and tokens.

| preset | stands for | arrivals | tokens in and out, at most |
|---|---|---|---|
| `chat` | a production chat service | gamma, two states of similar rate | 14,050 and 1,000 |
| `code` | a production code completion service | gamma, bursts and silence | 7,437 and 1,899 |

Both are fitted to the hour of each in the Azure LLM inference trace 2023 (P. Patel et al., "Splitwise: Efficient
Generative LLM Inference Using Phase Splitting", ISCA 2024; CC-BY 4.0): rate, coefficient of variation of the distances,
Fano factor of counts at 1 s and 60 s; tokens by expectation maximisation. A single log-normal law with the mean and
standard deviation of the logarithms (6.63, 0.99 etc.) is off by 26 % at the median and 85 % at the 99 % quantile. The
reason is that contexts and answers accumulate at a few lengths, which a mixture represents by narrow parts.
`python -m docs.studies.traces.generated_requests` prints the quality of the fit.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import asdict, dataclass, replace
from statistics import NormalDist

import numpy as np

from dcgrid_env.traces.checks import FloatArray, TraceError, require_positive
from dcgrid_env.traces.provenance import Provenance
from dcgrid_env.traces.serving.arrivals import Arrivals
from dcgrid_env.traces.serving.requests import IntArray, Requests
from dcgrid_env.traces.time_grid import stream


@dataclass(frozen=True)
class TokenLaw:
    """Numbers of tokens from a mixture of log-normal laws, rounded, at least 1 and at most `most`.

    TraceError for fields out of range.
    """

    parts: tuple[tuple[float, float, float], ...]
    """(weight, mean of the logarithm, its standard deviation) of each part; weights need not add up to 1."""
    most: int

    def __post_init__(self) -> None:
        if not self.parts or self.most < 1:
            raise TraceError(f"TokenLaw(parts={self.parts!r}, most={self.most!r}): give a part, and at least 1 token")
        for weight, log_mean, log_std in self.parts:
            require_positive(weight, "TokenLaw: weight", "give a part's weight")
            require_positive(log_std, "TokenLaw: log_std", "give a standard deviation of the logarithm")
            if not math.isfinite(log_mean):
                raise TraceError(f"TokenLaw: log_mean = {log_mean!r} is not a finite number")

    def draw(self, rng: np.random.Generator, n: int) -> IntArray:
        """Draw (n,) int64."""
        log_mean, log_std = (np.array(column) for column in list(zip(*self.parts, strict=True))[1:])
        weight = self._weights()
        part = np.searchsorted(np.cumsum(weight)[:-1], rng.random(n), side="right") if len(weight) > 1 else 0
        tokens = np.exp(log_mean[part] + log_std[part] * rng.standard_normal(n))
        return np.clip(np.rint(tokens), 1, self.most).astype(np.int64)

    @property
    def mean(self) -> float:
        """Mean number of tokens, without rounding."""
        cdf, total = NormalDist().cdf, 0.0
        for weight, (_, log_mean, log_std) in zip(self._weights(), self.parts, strict=True):
            edge = (math.log(self.most) - log_mean) / log_std
            whole = math.exp(log_mean + 0.5 * log_std**2)
            total += weight * (whole * cdf(edge - log_std) + self.most * (1.0 - cdf(edge)))
        return float(total)

    def _weights(self) -> FloatArray:
        weight = np.array([weight for weight, _, _ in self.parts])
        return weight / weight.sum()


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
            Arrivals(5.53, shape=0.95, calm_rate=0.61, calm_s=300.0, busy_s=300.0),
            context=TokenLaw(
                ((0.591, 6.21, 1.01), (0.294, 6.98, 0.06), (0.038, 7.18, 0.02), (0.076, 8.32, 0.02)), 14_050
            ),
            generated=TokenLaw(
                ((0.138, 4.22, 0.96), (0.536, 4.60, 0.41), (0.272, 6.00, 0.05), (0.054, 6.23, 0.14)), 1000
            ),
        ),
        Service(
            "code",
            Arrivals(2.57, shape=0.4, calm_rate=0.0, calm_s=44.0, busy_s=10.5),
            context=TokenLaw(((0.315, 5.53, 1.29), (0.634, 7.57, 0.64), (0.051, 8.91, 0.02)), 7437),
            generated=TokenLaw(((0.20, 1.98, 0.17), (0.53, 2.58, 0.38), (0.27, 3.72, 1.0)), 1899),
        ),
    )
}
"""Services by name."""


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

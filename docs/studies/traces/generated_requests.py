"""Compare generated requests with what is published: `python -m docs.studies.traces.generated_requests [LOG ...]`.

Each LOG is a request log (Azure's format), whose figures are listed next to the published ones.
"""

import sys
from collections.abc import Sequence

import numpy as np

from dcgrid_env.traces.checks import TraceError
from dcgrid_env.traces.serving.requests import Requests
from dcgrid_env.traces.serving.services import SERVICES, requests

FIGURES = (
    "rate (1/s)",
    "distance, coefficient of variation",
    "Fano factor at 1 s",
    "Fano factor at 60 s",
    *(
        f"{kind} tokens, {statistic}"
        for kind in ("context", "generated")
        for statistic in ("50 %", "90 %", "95 %", "99 %", "mean")
    ),
)

RECORDED: dict[str, tuple[float, ...]] = {
    "chat": (5.53, 1.09, 1.39, 16.1, 1020, 2734, 4083, 4142, 1155, 129, 424, 451, 601, 211),
    "code": (2.57, 13.2, 13.2, 164, 1469, 5186, 7303, 7436, 2048, 13, 55, 90, 249, 27.9),
}
"""Read off the hour of each service in the Azure LLM inference trace 2023 (CC-BY 4.0, P. Patel et al., ISCA 2024).

The Fano factors are those of complete windows; with the incomplete last minute the chat service has 20.6 at 60 s.
"""

TOLERANCE = (0.03, 0.08, 0.08, 0.15, *(0.15,) * 10)
"""Relative, of the mean over seeds of 24 h."""


def figures(sample: Requests) -> np.ndarray:
    """FIGURES of requests, (14,) float64."""
    distance_s = np.diff(sample.arrival_s)
    tokens = [
        [*np.quantile(counts, [0.5, 0.9, 0.95, 0.99]), counts.mean()]
        for counts in (sample.context_tokens, sample.generated_tokens)
    ]
    spread = distance_s.std() / distance_s.mean()
    rate_per_s = len(sample) / sample.duration_s
    return np.array([rate_per_s, spread, fano(sample, 1.0), fano(sample, 60.0), *tokens[0], *tokens[1]])


def fano(sample: Requests, window_s: float) -> float:
    """Variance over mean of the number of arrivals in windows; an incomplete last window is left out."""
    n = int(sample.duration_s / window_s + 1e-9)
    counts = np.bincount((sample.arrival_s / window_s).astype(np.int64), minlength=n)[:n]
    return float(counts.var() / counts.mean())


def main(arguments: Sequence[str], seeds: int = 10) -> int:
    """Print a Markdown table for each service and for each log; return the exit status."""
    for name in SERVICES:
        drawn = np.array([figures(requests(name, 24.0, seed)) for seed in range(seeds)])
        print(f"\n| `{name}` | recorded | generated, mean of {seeds} days | least .. most | off by | tolerance |")
        print("|---|---|---|---|---|---|")
        rows = zip(FIGURES, RECORDED[name], drawn.mean(0), drawn.min(0), drawn.max(0), TOLERANCE, strict=True)
        for figure, target, mean, low, high, tolerance in rows:
            numbers = (f"{x:.0f}" if "tokens" in figure else f"{x:.2f}" for x in (target, mean, low, high))
            cells = "| {} | {} | {} | {} .. {} |".format(figure, *numbers)
            print(f"{cells} {100 * (mean / target - 1):+.0f} % | {100 * tolerance:.0f} % |")
    from dcgrid_env.traces.logs.request_log import read_request_log

    for path in arguments:
        try:
            log = read_request_log(path)
        except (TraceError, OSError) as error:
            print(error, file=sys.stderr)
            return 1
        print(f"\n{log.name}: " + ", ".join(f"{f} {x:.4g}" for f, x in zip(FIGURES, figures(log), strict=True)))
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))

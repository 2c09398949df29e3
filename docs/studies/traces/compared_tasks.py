"""Four models on the same GPUs under the same waves of queries: `python -m docs.studies.traces.compared_tasks`.

A counterpart of Fig. 2 of Chen and Zhang (arXiv 2507.06416), whose recordings are not published. The paper says of
its four tasks: ramps of 10 to 20 % dominate, the models of middle size swing most, and valleys and peaks repeat with a
long period.
"""

import numpy as np

from dcgrid_env.traces.checks import FloatArray
from dcgrid_env.traces.sources import TRACE_SOURCES

TASKS = ("llama3-70b", "llama3-405b", "mixtral-8x22b", "deepseek-v3")
FIGURES = (
    "mean level",
    "standard deviation",
    "1-s ramps: 99 %",
    "steepest 1-s ramp",
    "of the ramps beyond 5 %: in 10 to 20 %",
    "of the ramps beyond 5 %: beyond 20 %",
    "waves: period (s)",
    "waves: correlation over a period",
)


def figures(second: FloatArray) -> FloatArray:
    """FIGURES of means over seconds (n,), shares of the rating."""
    ramp = np.abs(np.diff(second))
    large = ramp[ramp > 0.05]
    level = second - second.mean()
    lags = np.arange(40, 90)
    together = np.array([(level[:-lag] * level[lag:]).mean() for lag in lags]) / (level * level).mean()
    return np.array(
        [
            second.mean(),
            second.std(),
            np.quantile(ramp, 0.99),
            ramp.max(),
            ((large > 0.1) & (large <= 0.2)).mean(),
            (large > 0.2).mean(),
            lags[np.argmax(together)],
            together.max(),
        ]
    )


def main(seeds: int = 8) -> None:
    """Print a Markdown table, means over half hours."""
    print("| | " + " | ".join(TASKS) + " |\n|---|" + "---|" * len(TASKS))
    columns = []
    for task in TASKS:
        traces = [TRACE_SOURCES[task].generate(1800.0, seed).resample(1.0) for seed in range(seeds)]
        columns.append(np.mean([figures(trace) for trace in traces], axis=0))
    for name, row in zip(FIGURES, np.transpose(columns), strict=True):
        digits = 0 if "(s)" in name else 3
        print(f"| {name} | " + " | ".join(f"{x:.{digits}f}" for x in row) + " |")


if __name__ == "__main__":
    main()

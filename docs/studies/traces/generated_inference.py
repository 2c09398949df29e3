"""Compare the generator of inference power with a recording.

Use: `python -m docs.studies.traces.generated_inference RECORDING.csv`.
"""

import sys
from collections.abc import Sequence

import numpy as np

from dcgrid_env.traces.checks import FloatArray, TraceError
from dcgrid_env.traces.inference import generate_inference
from dcgrid_env.traces.trace import PowerTrace

# Between the idle plateau (0.27) and the deepest dip within a recorded burst (0.53).
ACTIVE_SHARE = 0.4


def figures(trace: PowerTrace) -> dict[str, float]:
    """Return the compared figures of a trace in share of rating, averaged over seconds where the name states it.

    Levels are shares of rating, bursts are runs of seconds above ACTIVE_SHARE; a figure that does not exist is NaN.
    """
    second = trace.resample(1.0)
    tenth = trace.resample(0.1)
    step = np.abs(np.diff(second))
    active = second > ACTIVE_SHARE
    burst_s = burst_lengths_s(second)
    busy = tenth[tenth > ACTIVE_SHARE]
    nan = float("nan")
    return {
        "lowest level": float(trace.power_kw.min()),
        "idle level, median": float(np.median(second[~active])),
        "mean level": float(second.mean()),
        "share of time active": float(active.mean()),
        "active level, mean": float(busy.mean()) if busy.size else nan,
        "active level, standard deviation (0.1 s)": float(busy.std()) if busy.size else nan,
        "bursts in an hour": len(burst_s) * 3600 / trace.duration_s,
        "burst, mean (s)": float(burst_s.mean()) if burst_s.size else nan,
        "burst, longest (s)": float(burst_s.max()) if burst_s.size else nan,
        "1-s step, median": float(np.median(step)),
        "1-s step, 90 %": float(np.quantile(step, 0.9)),
        "1-s step, 95 %": float(np.quantile(step, 0.95)),
        "1-s step, 99 %": float(np.quantile(step, 0.99)),
        "1-s step, steepest": float(step.max()),
    }


def as_logged(trace: PowerTrace, time_s: FloatArray) -> PowerTrace:
    """Return the trace as a logger that reads it at `time_s` (n,), s from the start, would record it."""
    index = np.searchsorted(trace.time_s, time_s, side="right") - 1
    return PowerTrace(time_s, trace.power_kw[index], trace.name, trace.provenance)


def comparison(recording: PowerTrace, n_windows: int = 200) -> dict[str, tuple[float, FloatArray, float]]:
    """Compare figures of a recording with those of generated windows of its length.

    Returns
    -------
    figure -> (recorded, (3,) 5 %, 50 % and 95 % of generated windows read as the recording was, mean of the same
    windows read at the full 0.1 s)
    """
    recorded = figures(recording.as_share())
    time_s = recording.time_s - recording.time_s[0]
    windows = [generate_inference(recording.duration_s, seed) for seed in range(n_windows)]
    logged = [figures(as_logged(window, time_s)) for window in windows]
    full = [figures(window) for window in windows]
    return {
        name: (
            value,
            np.nanquantile([f[name] for f in logged], [0.05, 0.5, 0.95]),
            float(np.nanmean([f[name] for f in full])),
        )
        for name, value in recorded.items()
    }


def distances(recording: PowerTrace, n_windows: int = 200) -> dict[str, tuple[float, float, FloatArray]]:
    """Compute two-sample distances between the recording and all generated windows, sampled like the recording.

    Returns
    -------
    compared quantity -> (Wasserstein distance, Kolmogorov-Smirnov statistic, (2,) median and 95 % of that statistic)

    The median and 95 % are of one generated window against all others. They show the distance that a sample as short
    as the recording has by chance.
    """
    from scipy.stats import wasserstein_distance

    time_s = recording.time_s - recording.time_s[0]
    windows = [generate_inference(recording.duration_s, seed) for seed in range(n_windows)]
    recorded = _samples(recording.as_share())
    single = [_samples(as_logged(window, time_s)) for window in windows]
    distances = {}
    for name, sample in recorded.items():
        pooled = np.concatenate([s[name] for s in single])
        chance = [_ks(s[name], pooled) for s in single if s[name].size]
        ks = _ks(sample, pooled)
        distances[name] = (float(wasserstein_distance(sample, pooled)), ks, np.quantile(chance, [0.5, 0.95]))
    return distances


def _ks(a: FloatArray, b: FloatArray) -> float:
    """The two-sample Kolmogorov-Smirnov statistic."""
    from scipy.stats import ks_2samp

    return float(np.asarray(ks_2samp(a, b))[0])


def _samples(trace: PowerTrace) -> dict[str, FloatArray]:
    second = trace.resample(1.0)
    step = np.diff(second)
    return {
        "level, 1 s means": second,
        "1-s ramp": step,
        "1-s ramp beyond 5 % of the rating": step[np.abs(step) > 0.05],
        "burst length (s)": burst_lengths_s(second).astype(np.float64),
    }


def burst_lengths_s(second: FloatArray) -> np.ndarray:
    """Lengths of the runs above ACTIVE_SHARE in means over seconds (n,), s."""
    change = np.diff(np.concatenate([[0], (second > ACTIVE_SHARE).astype(int), [0]]))
    return np.flatnonzero(change == -1) - np.flatnonzero(change == 1)


def main(arguments: Sequence[str]) -> int:
    """Print the comparison as a Markdown table; return the exit status."""
    if len(arguments) != 1:
        print("usage: python -m docs.studies.traces.generated_inference RECORDING.csv", file=sys.stderr)
        return 2
    try:
        recording = PowerTrace.from_csv(arguments[0])
    except (TraceError, OSError) as error:
        print(error, file=sys.stderr)
        return 1
    print("| figure | recorded | generated, median (5 % .. 95 %) | mean at full resolution |")
    print("|---|---|---|---|")
    for name, (recorded, (low, middle, high), mean) in comparison(recording).items():
        digits = 1 if "(s)" in name or "hour" in name else 3
        cells = (f"{x:.{digits}f}" for x in (recorded, middle, low, high, mean))
        print("| {} | {} | {} ({} .. {}) | {} |".format(name, *cells))
    print("\n| distribution | Wasserstein distance | Kolmogorov-Smirnov statistic | by chance, median (95 %) |")
    print("|---|---|---|---|")
    for name, (wasserstein, ks, (middle, high)) in distances(recording).items():
        print(f"| {name} | {wasserstein:.4f} | {ks:.3f} | {middle:.3f} ({high:.3f}) |")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))

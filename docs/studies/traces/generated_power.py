"""Compare spectra and ramps of generators with recordings: `python -m docs.studies.traces.generated_power SOURCE=FILE`.

The sources are `inference` (a recording of power) and `chat` and `code` (a log of requests). Requests, recorded and
generated, are served by the same GPUs.
"""

import sys
from collections.abc import Callable, Sequence

import numpy as np

from dcgrid_env.traces.checks import FloatArray, TraceError
from dcgrid_env.traces.inference import generate_inference
from dcgrid_env.traces.logs.request_log import read_request_log
from dcgrid_env.traces.recording_file import served
from dcgrid_env.traces.serving.hardware import replica
from dcgrid_env.traces.serving.pool import serve
from dcgrid_env.traces.serving.services import SERVICES, requests
from dcgrid_env.traces.time_grid import GRID_S
from dcgrid_env.traces.trace import PowerTrace
from docs.studies.traces.generated_inference import as_logged

BANDS_HZ = {
    "up to 1/60 Hz": (0.0, 1 / 60),
    "1/60 to 0.1 Hz": (1 / 60, 0.1),
    "0.1 to 1 Hz": (0.1, 1.0),
    "1 to 5 Hz": (1.0, 5.0),
}
"""Bands of the spectrum, lower edges excluded."""
RAMP_QUANTILES = (0.5, 0.95, 0.99, 0.999, 1.0)
WINDOWS = {"inference": 100, "chat": 20, "code": 20}
"""Generated windows of the length of the recording, by source."""


def power_figures(trace: PowerTrace) -> dict[str, float]:
    """Return quantiles of the ramps over 1 s and the standard deviation in bands of frequency, as shares of the rating.

    The squares of the standard deviations add up to the variance of the means over 0.1 s.
    """
    ramp = np.abs(np.diff(trace.resample(1.0)))
    quantiles = {
        "1-s ramp, largest" if q == 1.0 else f"1-s ramp, {100 * q:g} %": float(np.quantile(ramp, q))
        for q in RAMP_QUANTILES
    }
    deviations = band_deviations(trace.resample(GRID_S)).tolist()
    return quantiles | {f"standard deviation, {band}": value for band, value in zip(BANDS_HZ, deviations, strict=True)}


def band_deviations(share: FloatArray) -> FloatArray:
    """Return the standard deviation of samples (n,), GRID_S apart, in each band of BANDS_HZ, (n_band,)."""
    n = len(share)
    power = np.abs(np.fft.rfft(share - share.mean())) ** 2 / n**2
    power[1 : (n + 1) // 2] *= 2.0  # both signs of the frequency
    frequency_hz = np.fft.rfftfreq(n, GRID_S)
    return np.array(
        [np.sqrt(power[(frequency_hz > low) & (frequency_hz <= high)].sum()) for low, high in BANDS_HZ.values()]
    )


def comparison(source: str, path: str) -> dict[str, tuple[float, FloatArray]]:
    """Return the figures of a recording, and their 5, 50 and 95 % over generated windows of its length, (3,).

    Raises TraceError for a source without a recording to compare, and for a file that cannot be read.
    """
    if source == "inference":
        recorded, generate = _inference(path)
    elif source in SERVICES:
        recorded, generate = _service(source, path)
    else:
        raise TraceError(f"source {source!r} has no recording to compare with; choose one of {', '.join(WINDOWS)}")
    windows = [power_figures(generate(seed)) for seed in range(WINDOWS[source])]
    return {
        name: (value, np.quantile([window[name] for window in windows], [0.05, 0.5, 0.95]))
        for name, value in power_figures(recorded).items()
    }


def _inference(path: str) -> tuple[PowerTrace, Callable[[int], PowerTrace]]:
    """Return a recording of power, and the generator of windows as its logger would record them."""
    recorded = PowerTrace.from_csv(path).as_share()
    time_s = recorded.time_s - recorded.time_s[0]
    return recorded, lambda seed: as_logged(generate_inference(recorded.duration_s, seed), time_s)


def _service(name: str, path: str) -> tuple[PowerTrace, Callable[[int], PowerTrace]]:
    """Return the power of recorded requests, and the generator of the power of as many hours of the service."""
    recorded = served(log := read_request_log(path))
    n_replicas = recorded.provenance.parameters["served_by"]["replicas"]
    unit, hours = replica("H100", "llama3-70b"), log.duration_s / 3600.0
    return recorded, lambda seed: serve(requests(name, hours, seed), unit, n_replicas).trace


def main(arguments: Sequence[str]) -> int:
    """Print a Markdown table for each source; return the exit status."""
    pairs = [argument.partition("=") for argument in arguments]
    if not pairs or not all(path for _, _, path in pairs):
        print("usage: python -m docs.studies.traces.generated_power SOURCE=FILE ...", file=sys.stderr)
        return 2
    try:
        for source, _, path in pairs:
            print(f"| `{source}` | recorded | generated, median (5 % .. 95 %) |\n|---|---|---|")
            for name, (value, (low, middle, high)) in comparison(source, path).items():
                print(f"| {name} | {value:.3f} | {middle:.3f} ({low:.3f} .. {high:.3f}) |")
            print()
    except (TraceError, OSError) as error:
        print(error, file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))

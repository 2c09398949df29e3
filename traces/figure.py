"""The picture of a trace: power, ramps, spectrum and duration curve, one trace over another."""

from __future__ import annotations

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from dcgrid_env.traces.time_grid import GRID_S
from dcgrid_env.traces.trace import PowerTrace

COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7")


def trace_figure(traces: dict[str, PowerTrace], dt_s: float = 1.0) -> Figure:
    """Draw four panels with every trace, each as a share of its peak.

    Parameters
    ----------
    traces : label in the legend -> trace; up to four have distinct colours.
    dt_s : step of the averages behind power, ramps and duration curve, s; the spectrum takes steps of 0.1 s.
    """
    figure = Figure(figsize=(12.0, 7.6), layout="constrained")
    FigureCanvasAgg(figure)
    (power, ramps), (spectrum, duration) = figure.subplots(2, 2)
    steepest = 0.0
    for (label, trace), colour in zip(traces.items(), COLOURS, strict=False):
        share = trace.as_share()
        mean = share.resample(dt_s)
        ramp = np.diff(mean)
        steepest = max(steepest, float(np.abs(ramp).max(initial=0.0)))
        power.step(np.arange(len(mean)) * dt_s, mean, where="post", color=colour, linewidth=0.9, label=label)
        ramps.hist(ramp, bins=np.linspace(-1.0, 1.0, 201), histtype="step", color=colour, density=True, linewidth=1.2)
        spectrum.loglog(*_spectrum(share.resample(GRID_S)), color=colour, linewidth=1.0)
        duration.plot(np.linspace(0.0, 100.0, len(mean)), np.sort(mean)[::-1], color=colour, linewidth=1.6)
    _say(power, "time (s)", "share of the peak", f"power, means over {dt_s:g} s")
    power.set_ylim(0.0, 1.05)
    figure.legend(*power.get_legend_handles_labels(), loc="outside upper center", ncols=4, frameon=False)
    _say(ramps, f"change within {dt_s:g} s, share of the peak", "density", "ramps")
    ramps.set_yscale("log")
    ramps.set_xlim(-1.1 * max(steepest, 0.01), 1.1 * max(steepest, 0.01))
    _say(spectrum, "frequency (Hz)", "density (share$^2$/Hz)", f"spectrum, means over {GRID_S:g} s")
    _say(duration, "time exceeded (%)", "share of the peak", "duration curve")
    duration.set_ylim(0.0, 1.05)
    return figure


def _spectrum(share: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Frequencies (n,), Hz, and power spectral density (n,) by Welch's method in pieces of at most 20 min."""
    from scipy.signal import welch

    frequency_hz, density = welch(share, fs=1.0 / GRID_S, nperseg=min(len(share), 12_000))
    return frequency_hz[1:], np.maximum(density[1:], 1e-12)


def _say(ax, x: str, y: str, title: str) -> None:
    ax.set_xlabel(x)
    ax.set_ylabel(y)
    ax.set_title(title, fontsize=11)
    ax.grid(alpha=0.25, linewidth=0.6)
    ax.spines[["top", "right"]].set_visible(False)

"""The picture of a trace holds what it says."""

import numpy as np
import pytest

from dcgrid_env.traces import PowerTrace, generate_training
from dcgrid_env.traces.figure import trace_figure


@pytest.mark.slow
def test_panels_show_the_traces():
    steady = PowerTrace([0, 60], [2.0, 2.0], "steady")
    figure = trace_figure({"training": generate_training(600.0, 1), "steady": steady})
    power, ramps, spectrum, duration = figure.axes
    for ax in (power, spectrum, duration):
        assert len(ax.lines) == 2
    seconds = generate_training(600.0, 1).as_share().resample(1.0)
    np.testing.assert_array_equal(np.asarray(power.lines[0].get_ydata()), seconds)
    np.testing.assert_array_equal(np.asarray(duration.lines[0].get_ydata()), np.sort(seconds)[::-1])
    assert len(ramps.patches) == 2
    assert [text.get_text() for text in figure.legends[0].get_texts()] == ["training", "steady"]
    figure.canvas.draw()


def test_an_oscillation_is_a_peak_in_the_spectrum():
    time_s = np.arange(6001) * 0.1
    wave = PowerTrace(time_s, 2.0 + np.sin(2 * np.pi * 0.5 * time_s), "wave")
    line = trace_figure({"wave": wave}).axes[2].lines[0]
    frequency_hz, density = np.asarray(line.get_xdata()), np.asarray(line.get_ydata())
    assert abs(frequency_hz[np.argmax(density)] - 0.5) < 0.01

"""Figures of spectra and ramps, and the command that compares them with recordings."""

import numpy as np
import pytest

from dcgrid_env.traces import PowerTrace, TraceError, generate_inference
from docs.studies.traces.generated_power import BANDS_HZ, band_deviations, comparison, main, power_figures

GRID = np.arange(12_000) / 10.0


@pytest.mark.parametrize(("frequency_hz", "band"), [(0.01, 0), (0.05, 1), (0.5, 2), (1.0, 2), (2.0, 3), (5.0, 3)])
def test_a_wave_is_in_the_band_of_its_frequency(frequency_hz, band):
    share = 0.5 + 0.1 * np.cos(2 * np.pi * frequency_hz * GRID)
    deviations = band_deviations(share)
    np.testing.assert_allclose(deviations, np.where(np.arange(len(BANDS_HZ)) == band, share.std(), 0.0), atol=1e-9)


@pytest.mark.parametrize("n", [999, 1000])
def test_the_bands_add_up_to_the_variance(n):
    share = np.random.default_rng(0).random(n)
    assert np.sum(band_deviations(share) ** 2) == pytest.approx(share.var())


def test_ramps_are_over_a_second():
    figures = power_figures(PowerTrace(np.arange(11.0), np.arange(11.0) ** 2 / 100.0, rated_kw=1.0))
    assert figures["1-s ramp, 50 %"] == pytest.approx(0.09)
    assert figures["1-s ramp, largest"] == pytest.approx(0.17)


def test_a_recording_of_the_only_window_has_its_figures(tmp_path, monkeypatch):
    monkeypatch.setattr("docs.studies.traces.generated_power.WINDOWS", {"inference": 1})
    generate_inference(300.0, 0).to_csv(tmp_path / "power.csv")
    for name, (recorded, generated) in comparison("inference", str(tmp_path / "power.csv")).items():
        np.testing.assert_allclose(generated, recorded, rtol=1e-9, err_msg=name)
    with pytest.raises(TraceError, match="source 'site' has no recording to compare with; choose one of inference"):
        comparison("site", str(tmp_path / "power.csv"))


def test_the_command_names_its_arguments_and_what_is_missing(tmp_path, capsys):
    assert main([]) == main(["chat"]) == 2
    assert "usage: python -m docs.studies.traces.generated_power SOURCE=FILE" in capsys.readouterr().err
    assert main([f"chat={tmp_path}/none.csv"]) == 1
    assert "none.csv" in capsys.readouterr().err

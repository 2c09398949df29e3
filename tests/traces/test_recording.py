"""The recorded GPU trace: published figures, and the generator compared with it.

The recording is not shipped; where the folder `shared` beside the checkout is absent, these tests are skipped.
"""

import hashlib

import numpy as np
import pytest

from dcgrid_env.traces import PowerTrace, from_recordings
from docs.studies.traces.generated_inference import ACTIVE_SHARE, comparison, figures, main
from helpers.places import GPU_RECORDING, needs_gpu_recording

SHA256 = "c0c15af80a91a73fd23434c571d48a8156fa28119df7bccf4015141d67b52d83"


@pytest.fixture(scope="module")
def recording():
    assert hashlib.sha256(GPU_RECORDING.read_bytes()).hexdigest() == SHA256
    return PowerTrace.from_csv(GPU_RECORDING)


@needs_gpu_recording
def test_published_figures(recording):
    # 8 GPUs over 555 s, sum 546 to 2395 W, samples 0.1 to 3 s apart.
    assert len(recording.power_kw) == 1695
    assert recording.power_kw.min() == pytest.approx(0.546, abs=5e-4)
    assert recording.power_kw.max() == pytest.approx(2.395, abs=5e-4)
    assert recording.duration_s == pytest.approx(555.5, abs=0.1)
    gaps_s = np.diff(recording.time_s)
    assert 0.1 <= gaps_s.min() <= gaps_s.max() <= 3.01
    one_gpu = PowerTrace.from_csv(GPU_RECORDING, power_columns=[1])
    assert 0.064 <= one_gpu.power_kw.min() <= 0.085
    assert 0.329 <= one_gpu.power_kw.max() <= 0.345


@needs_gpu_recording
def test_figures_of_the_recording(recording):
    recorded = figures(recording.as_share())
    assert recorded["lowest level"] == pytest.approx(0.228, abs=5e-4)
    # The steepest second moves 55 % of the peak; on the grid that begins with the first sample, 53 %.
    assert recorded["1-s step, steepest"] == pytest.approx(0.55, abs=0.03)
    assert recorded["burst, longest (s)"] == 25.0
    # A tenth of the readings are active; they are closer together than the others.
    assert np.mean(recording.as_share().power_kw > ACTIVE_SHARE) == pytest.approx(0.10, abs=0.01)


@needs_gpu_recording
def test_energy_of_the_recording_is_kept(recording):
    dt_s = recording.duration_s / 1000
    assert recording.resample(dt_s).sum() * dt_s == pytest.approx(recording.energy_kws, rel=1e-9)


@needs_gpu_recording
def test_generated_windows_surround_the_recording(recording):
    table = comparison(recording, n_windows=60)
    for name in (
        "mean level",
        "share of time active",
        "active level, mean",
        "active level, standard deviation (0.1 s)",
        "bursts in an hour",
        "burst, mean (s)",
        "burst, longest (s)",
        "1-s step, 90 %",
        "1-s step, 95 %",
        "1-s step, 99 %",
        "1-s step, steepest",
    ):
        recorded, (low, _, high), _ = table[name]
        assert low <= recorded <= high, name
    for name, tolerance in (("lowest level", 0.005), ("idle level, median", 0.005), ("mean level", 0.03)):
        recorded, (_, middle, _), _ = table[name]
        assert abs(recorded - middle) <= tolerance, name


@needs_gpu_recording
def test_splits_of_the_recording(recording):
    rows = from_recordings([recording], "train", 1.0, window_s=120.0).p_share
    assert rows.shape == (1, 333)
    assert 0.22 < rows.min() < rows.max() <= 1.0


def test_the_command_says_what_it_needs(capsys, tmp_path):
    assert main([]) == 2
    assert "usage" in capsys.readouterr().err
    path = tmp_path / "bad.csv"
    path.write_text("0,1\n0,1\n", encoding="utf-8")
    assert main([str(path)]) == 1
    assert "bad.csv, line 2" in capsys.readouterr().err

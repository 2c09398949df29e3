"""The load of the study: recorded if available, otherwise generated; the table states which."""

import shutil

import numpy as np
import pytest

from dcgrid_env.apps.reproduction.load import choose_load
from dcgrid_env.apps.reproduction.study_runs import Setting
from dcgrid_env.baselines import NoControl, rollout
from dcgrid_env.traces import TraceError
from helpers.places import GPU_RECORDING, needs_gpu_recording


def test_auto_is_the_generator_where_nothing_has_been_fetched(tmp_path, monkeypatch):
    monkeypatch.setenv("DCGRID_CACHE", str(tmp_path))
    load = choose_load("auto")
    assert load.kind == "generated"
    assert load.fields == {"trace": "inference", "split": "test"}
    with pytest.raises(TraceError, match="dcgrid traces fetch chen-zhang-2025-inference"):
        choose_load("recorded")


@needs_gpu_recording
def test_auto_is_the_recording_once_it_is_in_the_cache(tmp_path, monkeypatch):
    monkeypatch.setenv("DCGRID_CACHE", str(tmp_path))
    shutil.copy(GPU_RECORDING, tmp_path / "chen-zhang-2025-inference.csv")
    load = choose_load("auto")
    assert load.kind == "recorded"
    assert "sha256 c0c15af80a91" in load.description
    assert "MIT" in load.description


@needs_gpu_recording
def test_the_whole_recording_is_drawn_from():
    load = choose_load(str(GPU_RECORDING))
    assert load.kind == "recorded"
    run = rollout(Setting(load, episodes=20).scenario(5), NoControl(), range(20))
    starts = np.concatenate([run.series(i).trace_start for i in range(20)])
    # 555 s less the 122 s of a window, not the 333 s or 111 s of a split's part.
    assert starts.min() < 60
    assert 380 < starts.max() <= 555 - 122


def test_a_generator_by_name_and_something_unknown():
    assert choose_load("code").fields["trace"] == "code"
    with pytest.raises(TraceError, match=r"no trace .*; `dcgrid list traces` lists all; or give a file"):
        choose_load("no-such-trace")

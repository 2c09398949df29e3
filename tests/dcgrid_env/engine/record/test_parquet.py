"""Trajectories of episodes as Parquet: their contents, and the files of a run that ends early."""

import sys

import numpy as np
import pytest

from dcgrid_env import ParquetCourse, make_scenario, scenario_hash
from dcgrid_env.baselines import Droop, rollout, streaming_rollout
from dcgrid_env.engine.record import parquet as parquet_course
from dcgrid_env.engine.record import streaming as streaming_recorder

parquet = pytest.importorskip("pyarrow.parquet")
S = make_scenario("ieee33-weak", split="test", horizon=40)
SEEDS = (5, 6)


@pytest.fixture
def small(monkeypatch):
    """A file for every 64 steps."""
    monkeypatch.setattr(streaming_recorder, "_PART_STEPS", (16, 64))
    monkeypatch.setattr(parquet_course, "FILE_BYTES", 1)


def written(folder, scenario=S):
    with ParquetCourse(folder, scenario, SEEDS) as course:
        streaming_rollout(scenario, Droop(), SEEDS, [course])
    return course


def test_every_step_of_every_episode_stands_there_once(tmp_path):
    course = written(tmp_path / "droop")
    (file,) = (tmp_path / "droop").iterdir()
    assert file.stat().st_size == course.bytes_written
    table = parquet.read_table(tmp_path / "droop")
    assert table["seed"].to_pylist() == [5] * 40 + [6] * 40
    assert table["step"].to_pylist() == [*range(1, 41)] * 2
    assert table["t_s"].to_pylist() == [*map(float, range(1, 41))] * 2
    whole = rollout(S, Droop(), SEEDS)
    for env_index in (0, 1):
        own, rows = whole.series(env_index), slice(40 * env_index, 40 * env_index + 40)
        column = lambda name, rows=rows: table[name].to_numpy()[rows]  # noqa: E731
        np.testing.assert_array_equal(column("cost_j"), own.cost_j)
        for i, bus in enumerate(S.feeder.bus_ids):
            np.testing.assert_array_equal(column(f"v_pu.{bus}"), own.v_pu[1:, i].astype(np.float32))
        for i, agent in enumerate(S.agents):
            np.testing.assert_array_equal(column(f"q_kvar.{agent}"), own.q_kvar[:, i].astype(np.float32))
        for i in range(S.n_sites):
            np.testing.assert_array_equal(column(f"f_mhz.dc_{i}"), own.f_mhz[:, i].astype(np.float32))
            np.testing.assert_array_equal(column(f"backlog_kws.dc_{i}"), own.backlog_kws[1:, i].astype(np.float32))
    about = parquet.read_schema(file).metadata
    assert about[b"dcgrid_scenario_hash"].decode() == scenario_hash(S)


def test_the_same_seeds_give_the_same_bytes_in_files_that_are_cut_alike(tmp_path, small):
    for name in ("a", "b"):
        written(tmp_path / name, S.replace(horizon=150))
    files = sorted((tmp_path / "a").iterdir())
    assert [file.name for file in files] == ["part-00000.parquet", "part-00001.parquet", "part-00002.parquet"]
    assert all(file.read_bytes() == (tmp_path / "b" / file.name).read_bytes() for file in files)
    steps = parquet.read_table(tmp_path / "a", columns=["seed", "step"]).to_pydict()
    assert sorted(zip(*steps.values(), strict=True)) == [(seed, k) for seed in SEEDS for k in range(1, 151)]


def test_an_error_half_way_leaves_the_whole_files_before_it(tmp_path, small, monkeypatch):
    """After a full disk or Ctrl-C, only complete files exist, and they can be read."""
    written_before = parquet_course.whole
    calls = []

    def full(path):
        calls.append(path)
        if len(calls) == 2:
            raise OSError(28, "No space left on device", str(path))
        return written_before(path)

    monkeypatch.setattr(parquet_course, "whole", full)
    with pytest.raises(OSError, match="No space left"):
        written(tmp_path / "course", S.replace(horizon=150))
    assert [file.name for file in (tmp_path / "course").iterdir()] == ["part-00000.parquet"]
    assert parquet.read_table(tmp_path / "course").num_rows == 2 * 64


def test_a_folder_of_an_earlier_run_has_none_of_it_left(tmp_path):
    old = [tmp_path / "part-00000.parquet", tmp_path / "part-00007.parquet", tmp_path / ".dcgrid-0.part"]
    for file in old:
        file.write_bytes(b"old")
    written(tmp_path)
    assert [file.name for file in tmp_path.iterdir()] == ["part-00000.parquet"]
    assert parquet.read_table(tmp_path).num_rows == 80


def test_without_pyarrow_there_is_one_line_with_the_remedy(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "pyarrow.parquet", None)
    remedy = r"pyarrow, which is missing; in a clone of the repository: pip install -e '.\[parquet\]'"
    with pytest.raises(ValueError, match=remedy):
        ParquetCourse(tmp_path / "course", S, SEEDS)
    assert not (tmp_path / "course").exists()


def test_a_three_phase_feeder_has_taps_and_banks(tmp_path):
    scenario = make_scenario("ieee13-3ph", split="test", horizon=5)
    with ParquetCourse(tmp_path, scenario, [0]) as course:
        streaming_rollout(scenario, Droop(), [0], [course])
    names = parquet.read_table(tmp_path).column_names
    assert {"tap.0", "capacitor_on.0", f"v_pu.{scenario.feeder.node_ids[4]}"} <= set(names)

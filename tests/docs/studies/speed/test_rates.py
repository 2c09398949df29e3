"""The measurements run and give figures. Their values depend on the machine and are not asserted."""

from __future__ import annotations

import json
import math

import numpy as np
import pytest

from dcgrid_env import make_scenario
from dcgrid_env.agents.algorithms.analytic import Learner
from docs.studies.commands import main
from docs.studies.speed import power_flow_rates, rates, tensors
from docs.studies.speed.environment_rates import memory_row
from docs.studies.speed.measuring import Row
from docs.studies.speed.power_flow_rates import Case
from docs.studies.speed.rates import Speed
from docs.studies.speed.reference_solvers import REFERENCE_SOLVERS, ReferenceSolver

QUICK = Speed(seconds=0.02, scenario="toy6", num_envs=3, feeders=40, memory_num_envs=6000, reference_solvers=False)


def check(rows: list[Row], worst_pu: float) -> None:
    assert rows
    for row in rows:
        assert row.name
        assert row.unit
        assert row.value is not None
        assert 0.0 < row.value < math.inf
        assert row.error_pu is None or 0.0 <= row.error_pu < worst_pu


@pytest.mark.slow
def test_every_row_is_a_positive_finite_figure(monkeypatch):
    monkeypatch.setattr(tensors, "NUM_ENVS", {"cpu": (3,)})
    rows = list(rates.measure(QUICK))
    exact = [row for row in rows if not row.name.startswith("lindistflow") and "float32" not in row.name]
    check(exact, worst_pu=1e-7)
    check(rows, worst_pu=0.1)
    assert len({(row.name, row.unit) for row in rows}) == len(rows) >= 10
    assert sum(row.error_pu is not None for row in exact) >= 4
    agents = len(make_scenario("toy6").agents)
    batches = [row for row in rows if row.name.startswith("DcgridVectorEnv")]
    a_step, of_agents = (row.value or 0.0 for row in batches if not row.name.endswith("ieee123-3ph"))
    assert len(batches) == 3
    assert math.isclose(of_agents, agents * a_step)
    assert not any(row.name.startswith(tuple(REFERENCE_SOLVERS)) for row in rows)
    of_tensors = [row.name for row in rows if row.name.startswith("TensorEnv")]
    assert of_tensors == [
        f"TensorEnv, 3 environments, torch cpu {precision}{gradient}"
        for precision in ("float32", "float64")
        for gradient in ("", ", gradient over 20 steps")
    ]


def test_reference_solvers_are_measured_or_reported_as_missing(monkeypatch):
    def build(feeder, v0_pu):
        case = Case.draw(make_scenario("toy6"), 40)
        exact = {p_kw.tobytes(): v_pu for p_kw, v_pu in zip(case.p_kw, case.v_pu, strict=True)}
        return ReferenceSolver("exact", lambda p, q: exact[p.tobytes()] + 1e-5, lambda p, q: case.v_pu + 2e-5)

    def outdated(feeder, v0_pu):
        raise ImportError("no such name")

    solvers = {"exact": (build, ()), "OpenDSS": (build, ()), "old": (outdated, ())}
    monkeypatch.setattr(power_flow_rates, "REFERENCE_SOLVERS", solvers)
    monkeypatch.setattr(power_flow_rates, "missing", lambda name: ["opendssdirect"] if name == "OpenDSS" else [])
    single, batch, absent, old = power_flow_rates.reference_rows(Case.draw(make_scenario("toy6"), 40), QUICK.seconds)
    check([single, batch], worst_pu=1e-4)
    np.testing.assert_allclose([single.error_pu or 0.0, batch.error_pu or 0.0], [1e-5, 2e-5])
    assert absent == Row("OpenDSS", None, "not installed (in a clone of the repository: pip install -e '.[bench]')")
    assert old == Row("old", None, "cannot be imported: no such name")


@pytest.mark.slow
def test_tensors_step_through_the_same_window_of_many_copies(monkeypatch):
    begun, stepped = [], []

    class Counted(tensors.TensorEnv):
        def reset(self, seeds, copies=1):
            begun.append((len(seeds), copies))
            return super().reset(seeds, copies)

        def step(self, action):
            stepped.append((self.step_number, action.shape[0]))
            return super().step(action)

    monkeypatch.setattr(tensors, "TensorEnv", Counted)
    monkeypatch.setattr(tensors, "rate", lambda work, amount, seconds: [work(), work()] and amount)
    scenario = make_scenario("toy6")
    monkeypatch.setattr(tensors, "NUM_ENVS", {"cpu": (512,)})
    assert [row.value for row in tensors.tensor_rows(scenario, "cpu", 0.01)] == [20 * 512] * 4
    assert begun == [(256, 2)] * 4
    assert stepped == [(k, 512) for k in range(20)] * 8


@pytest.mark.slow
def test_a_batch_that_does_not_fit_is_a_row_without_a_figure(monkeypatch):
    import torch

    def full(*_):
        raise torch.OutOfMemoryError("no memory left")

    monkeypatch.setattr(tensors, "rate", full)
    rows = list(tensors.tensor_rows(make_scenario("toy6"), "cpu", 0.01))
    assert {(row.value, row.unit) for row in rows} == {(None, "does not fit into memory")}
    assert len(rows) == 8


def test_without_torch_the_row_says_how_to_get_it(monkeypatch):
    monkeypatch.setattr(tensors, "find_spec", lambda name: None)
    (row,) = tensors.tensor_rows(make_scenario("toy6"), "cuda", 0.01)
    assert row == Row(
        "TensorEnv, torch", None, "not installed (in a clone of the repository: pip install -e '.[agents]')"
    )


@pytest.mark.parametrize(
    ("device", "message"),
    [
        ("gpu", "device is 'gpu', which torch does not know; give one of cpu, cuda"),
        ("meta", "device is 'meta'; give one of cpu, cuda"),
        ("cuda:99", r"device is 'cuda:99', but torch finds \d+ of that kind here; give cpu"),
    ],
)
def test_a_device_that_is_not_there(device, message, capsys):
    with pytest.raises(ValueError, match=message):
        tensors.tensor_rows(make_scenario("toy6"), device, 0.01)
    with pytest.raises(SystemExit, match="2"):
        main(["speed", "--scenario", "toy6", "--device", device])
    assert len(capsys.readouterr().err.strip().splitlines()) == 1


def test_the_changed_loads_are_a_fifth_of_a_per_cent_off():
    case = Case.draw(make_scenario("toy6"), 8)
    loaded = int(np.argmax(case.feeder.p_load_kw))
    ratio = case.changed().p_kw[:, loaded] / case.p_kw[:, loaded]
    np.testing.assert_allclose(np.abs(ratio - 1.0), 0.002)
    assert len(np.unique(np.sign(ratio - 1.0))) == 2


def test_the_command_prints_a_table_and_writes_json(tmp_path, capsys, monkeypatch):
    rows = [Row("steps [of some kind]", 1234.5, "steps/s", 1.5e-9), Row("absent", None, power_flow_rates.MISSING)]
    monkeypatch.setattr(rates, "measure", lambda cfg: iter(rows))
    monkeypatch.setenv("COLUMNS", "140")
    path = tmp_path / "new" / "speed.json"
    main(["speed", "--seconds", "0.02", "--no-reference-solvers", "--json", str(path)])
    printed = capsys.readouterr().out
    for text in ("steps [of some kind]", "1,23", "1.5e-09", "absent", "not installed", "numpy "):
        assert text in printed
    read = json.loads(path.read_text(encoding="utf-8"))
    assert [Row(**row) for row in read["rows"]] == rows
    assert read["settings"]["seconds"] == 0.02
    assert read["settings"]["reference_solvers"] is False
    assert read["meta"]["command"].startswith("python -m docs.studies speed --seconds")
    assert read["meta"]["versions"]["numpy"]
    assert read["meta"]["machine"]["cores"] >= 1
    assert [p.name for p in path.parent.iterdir()] == ["speed.json"]


@pytest.mark.parametrize(
    "bad",
    [
        ["--seconds", "0"],
        ["--num-envs", "0"],
        ["--feeders", "0"],
        ["--memory-num-envs", "-1"],
        ["--scenario", "nowhere"],
    ],
)
def test_bad_settings_end_with_one_line_and_status_2(bad, capsys):
    with pytest.raises(SystemExit, match="2"):
        main(["speed", *bad])
    assert len(capsys.readouterr().err.strip().splitlines()) == 1


@pytest.mark.slow
def test_a_memory_measurement_that_fails_says_why():
    with pytest.raises(RuntimeError, match="nowhere"):
        memory_row("nowhere", 1)


def test_a_training_is_timed_with_its_updates(monkeypatch, capsys):
    driven = []
    monkeypatch.setattr(Learner, "episodes", lambda self, i, iteration, require: driven.append((i, iteration)))
    main(["speed-training", "--scenario", "toy6", "--num-envs", "2", "--batches", "2", "--history", "1"])
    assert driven == [(0, 1), (0, 2), (0, 3)]  # the first is not counted
    assert "processor" in capsys.readouterr().out
    with pytest.raises(SystemExit):
        main(["speed-training", "--batches", "0"])
    assert capsys.readouterr().err == "dcgrid: batches is 0; give at least 1\n"

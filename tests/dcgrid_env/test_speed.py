"""The measurements run and give figures. What the figures are is never asserted: that is the machine's."""

from __future__ import annotations

import json
import math
from dataclasses import replace

import numpy as np
import pytest

from dcgrid_env import make_scenario, speed
from dcgrid_env.speed import Case, Row, Speed
from dcgrid_env.yardsticks import YARDSTICKS, Yardstick

QUICK = Speed(seconds=0.02, scenario="toy6", batch=3, feeders=40, lanes=6000, yardsticks=False)


def check(rows: list[Row], worst_pu: float) -> None:
    assert rows
    for row in rows:
        assert row.name
        assert row.unit
        assert row.value is not None
        assert 0.0 < row.value < math.inf
        assert row.error_pu is None or 0.0 <= row.error_pu < worst_pu


def test_every_row_is_a_positive_finite_figure():
    rows = list(speed.measure(QUICK))
    exact = [row for row in rows if not row.name.startswith("lindistflow")]
    check(exact, worst_pu=1e-7)
    check(rows, worst_pu=0.1)
    assert len({(row.name, row.unit) for row in rows}) == len(rows) >= 10
    assert sum(row.error_pu is not None for row in exact) >= 4
    agents = len(make_scenario("toy6").agents)
    a_step, of_agents = (row.value or 0.0 for row in rows if row.name.startswith("DcgridVectorEnv"))
    assert math.isclose(of_agents, agents * a_step)
    assert not any(row.name.startswith(tuple(YARDSTICKS)) for row in rows)


def test_yardsticks_are_measured_or_named_as_missing(monkeypatch):
    def build(feeder, v0_pu):
        case = Case.draw(make_scenario("toy6"), 40)
        exact = {p_kw.tobytes(): v_pu for p_kw, v_pu in zip(case.p_kw, case.v_pu, strict=True)}
        return Yardstick("known", lambda p, q: exact[p.tobytes()] + 1e-5, lambda p, q: case.v_pu + 2e-5)

    def outdated(feeder, v0_pu):
        raise ImportError("no such name")

    known = {"known": (build, ()), "OpenDSS": (build, ()), "old": (outdated, ())}
    monkeypatch.setattr(speed, "YARDSTICKS", known)
    monkeypatch.setattr(speed, "missing", lambda name: ["opendssdirect"] if name == "OpenDSS" else [])
    single, batch, absent, old = speed.yardstick_rows(Case.draw(make_scenario("toy6"), 40), QUICK)
    check([single, batch], worst_pu=1e-4)
    np.testing.assert_allclose([single.error_pu or 0.0, batch.error_pu or 0.0], [1e-5, 2e-5])
    assert absent == Row("OpenDSS", None, "not installed (pip install dcgrid-env[bench])")
    assert old == Row("old", None, "cannot be imported: no such name")


def test_the_changed_loads_are_a_fifth_of_a_per_cent_off():
    case = Case.draw(make_scenario("toy6"), 8)
    loaded = int(np.argmax(case.feeder.p_load_kw))
    ratio = case.changed().p_kw[:, loaded] / case.p_kw[:, loaded]
    np.testing.assert_allclose(np.abs(ratio - 1.0), 0.002)
    assert len(np.unique(np.sign(ratio - 1.0))) == 2


def test_the_command_prints_a_table_and_writes_json(tmp_path, capsys, monkeypatch):
    rows = [Row("steps [of some kind]", 1234.5, "steps/s", 1.5e-9), Row("absent", None, speed.MISSING)]
    monkeypatch.setattr(speed, "measure", lambda cfg: iter(rows))
    monkeypatch.setenv("COLUMNS", "140")
    path = tmp_path / "new" / "speed.json"
    speed.main(["--seconds", "0.02", "--no-yardsticks", "--json", str(path)])
    printed = capsys.readouterr().out
    for text in ("steps [of some kind]", "1,23", "1.5e-09", "absent", "pip install dcgrid-env[bench]", "numpy "):
        assert text in printed
    read = json.loads(path.read_text(encoding="utf-8"))
    assert [Row(**row) for row in read["rows"]] == rows
    assert read["settings"]["seconds"] == 0.02
    assert read["settings"]["yardsticks"] is False
    assert read["meta"]["command"].startswith("python -m dcgrid_env.speed")
    assert read["meta"]["versions"]["numpy"]
    assert read["meta"]["machine"]["cores"] >= 1
    assert [p.name for p in path.parent.iterdir()] == ["speed.json"]


@pytest.mark.parametrize(
    "bad", [["--seconds", "0"], ["--batch", "0"], ["--feeders", "0"], ["--lanes", "-1"], ["--scenario", "nowhere"]]
)
def test_bad_settings_end_with_one_line_and_status_2(bad, capsys):
    with pytest.raises(SystemExit, match="2"):
        speed.main(bad)
    assert len(capsys.readouterr().err.strip().splitlines()) == 1


def test_a_memory_measurement_that_fails_says_why():
    with pytest.raises(RuntimeError, match="nowhere"):
        speed.memory_row(replace(QUICK, scenario="nowhere"))

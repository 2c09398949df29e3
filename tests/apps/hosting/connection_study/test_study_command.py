"""``dcgrid study``: one report from one file, and one line for what is wrong in it."""

import json

import pytest

from dcgrid_env.cli.main import main

FILE = """
title = "A site"
feeder = "ieee33"
bus = "12"
mw = 0.2
controllers = ["none"]
leave_out = ["day", "fluctuation", "ride-through", "sensitivity"]

[set]
source_voltage_pu = 1.05

[capacity]
buses = ["18"]
samples = 2
window_s = 10.0
settle_s = 4.0
"""


@pytest.fixture(autouse=True)
def _elsewhere(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", "200")


@pytest.mark.slow
def test_it_prints_the_answer_and_writes_the_report(tmp_path, capsys):
    (tmp_path / "s.toml").write_text(FILE)
    main(["study", "s.toml", "--out", "out", "--workers", "1"])
    printed = capsys.readouterr().out
    assert "Without control, 0.2 MW at bus 12 fits: the bus carries" in printed
    record = json.loads((tmp_path / "out/report.json").read_text())
    assert record["capacity"]["study"]["buses"] == ["18", "12"]
    assert record["answers"][0] in printed
    text = (tmp_path / "out/report.html").read_text()
    assert text.startswith("<!doctype html>")
    assert (tmp_path / "out/capacity.csv").read_text().startswith("controller,bus")


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('bus = "12"', 'bus = "1"', "bus is '1'; give a bus of feeder 'ieee33' other than the substation"),
        ('feeder = "ieee33"', 'feeder = "nowhere"', "nowhere"),
        ("mw = 0.2", "mw = -1.0", "mw is -1.0; give a finite number"),
        ("mw = 0.2", "size = 3", "size is no field; its fields are bus"),
        ("samples = 2", "sample = 2", "capacity has no field 'sample'"),
        ("samples = 2", "samples = 0", "samples is 0"),
        ('title = "A site"', "title = ", "s.toml"),
        (
            "mw = 0.2",
            'mw = 0.2\noutages = ["capacitor c1"]',
            "outages: the balanced feeder 'ieee33' has no elements",
        ),
        ("mw = 0.2", 'mw = 0.2\nseveral_sites = {buses = ["99"]}', "99"),
        ("mw = 0.2", "mw = 0.2\nseveral_sites = {buses = [12]}", "it names the bus 12 itself; name other buses"),
    ],
)
def test_one_line_for_what_is_wrong_and_nothing_written(tmp_path, capsys, old, new, message):
    (tmp_path / "s.toml").write_text(FILE.replace(old, new))
    with pytest.raises(SystemExit):
        main(["study", "s.toml", "--out", "out", "--workers", "1"])
    said = capsys.readouterr().err.strip()
    assert message in said
    assert len(said.splitlines()) == 1
    assert not (tmp_path / "out").exists()


def test_a_missing_file_is_named(capsys):
    with pytest.raises(SystemExit):
        main(["study", "none.toml"])
    assert "there is no study file none.toml" in capsys.readouterr().err


def test_sites_of_a_scenario_that_are_drawn_are_refused(tmp_path, capsys):
    (tmp_path / "s.toml").write_text(FILE.replace('feeder = "ieee33"', 'scenario = "ieee123"'))
    with pytest.raises(SystemExit):
        main(["study", "s.toml", "--out", "out", "--workers", "1"])
    assert "draws the buses of its data centres in each episode" in capsys.readouterr().err


@pytest.mark.slow
def test_load_profiles_give_a_section_of_the_year(tmp_path):
    (tmp_path / "loads").mkdir()
    samples = "".join(f"{hour},{0.5 + 0.4 * (hour % 24 == 18)}\n" for hour in range(5 * 24))
    (tmp_path / "loads/day.csv").write_text("time_h,home\n" + samples)
    classes = "".join(f"{bus},home\n" for bus in range(2, 34))
    (tmp_path / "loads/classes.csv").write_text("load,class\n" + classes)
    profiles = (
        '[set.load_profiles]\nfile = "loads/day.csv"\ncolumns = "class"\nclasses = "loads/classes.csv"\n[capacity]'
    )
    (tmp_path / "s.toml").write_text(FILE.replace("[capacity]", profiles))
    main(["study", "s.toml", "--out", "out", "--workers", "1"])
    section = json.loads((tmp_path / "out/report.json").read_text())["sections"]["year"]
    assert "120 power flows in steps of 60 min" in section["text"][0]
    assert "32 loads follow a profile." in section["text"][0]
    worst = {(row[0], row[1]): row[2:] for row in section["tables"][1]["rows"]}
    assert worst["with 0.2 MW", "lowest voltage"][1] == "day 1 18:00"
    without, with_site = (worst[case, "lowest voltage"][0] for case in ("without the site", "with 0.2 MW"))
    assert with_site < without
    hours = [row[0] for row in section["tables"][2]["rows"]]
    assert hours == ["lowest voltage, highest loss", "highest voltage"]
    losses = section["tables"][0]["rows"][-1]
    assert float(losses[1]) < float(losses[2])


@pytest.mark.slow
def test_ten_minutes_of_a_log_and_half_a_day_of_loads_do(tmp_path, capsys):
    """The log's ramps of 1 % of the rating in a second are also those of the repeated log."""
    power = [300.0 + min(s % 200, 200 - s % 200) for s in range(600)]
    rows = "".join(f"2026-03-01T14:{s // 60:02d}:{s % 60:02d},{kw}\n" for s, kw in enumerate(power))
    (tmp_path / "log.csv").write_text("time,site_kw\n" + rows)
    loads = "".join(f"{hour},{0.5 + 0.4 * (hour == 9)}\n" for hour in range(12))
    (tmp_path / "day.csv").write_text("time_h,home\n" + loads)
    (tmp_path / "classes.csv").write_text("load,class\n" + "".join(f"{bus},home\n" for bus in range(2, 34)))
    more = (
        'trace = "log.csv"\n[set.load_profiles]\nfile = "day.csv"\ncolumns = "class"\nclasses = "classes.csv"\n'
        "[capacity]"
    )
    text = FILE.replace("[capacity]", more).replace(
        '"day", "fluctuation", "ride-through", "sensitivity"', '"ride-through"'
    )
    (tmp_path / "s.toml").write_text(text)
    main(["study", "s.toml", "--out", "out", "--workers", "1"])
    record = json.loads((tmp_path / "out/report.json").read_text())
    assert "episodes lie in the whole of trace log, 599 s and of " in capsys.readouterr().out
    sections = record["sections"]
    assert "lasts 599 s and episodes need 600.2 s, so it is repeated" in " ".join(sections["fluctuation"]["text"])
    ramp = float(sections["fluctuation"]["tables"][0]["rows"][0][1])
    assert ramp == pytest.approx(200.0 / 400.0, rel=1e-3)  # 1 kW/s of a peak of 400 kW, at a site of 200 kW
    assert "The 12 h from day 1 00:00 on" in sections["day"]["text"][0]
    assert "spread over all 12 hours of day.csv" in record["confidence"]
    assert "day 1 09:00 (highest load, lowest voltage)" in record["confidence"]
    assert record["capacity"]["study"]["hours_considered"] == 12
    assert {"log.csv", "day.csv"} <= {row[0] for row in sections["inputs"]["tables"][0]["rows"]}

"""``dcgrid capacity``: the table, the map, the CSV and the record, and what is refused."""

import csv
import json
from dataclasses import replace

import numpy as np
import pytest

from dcgrid_env import Feeder, load_feeder
from dcgrid_env.cli.main import main
from dcgrid_env.grid.network import LineTable, NodeTable, RatingTable, balanced_network

SHORT = ("--samples", "2", "--window-s", "10", "--settle-s", "4", "--workers", "1")
IEEE33 = ("--feeder", "ieee33", "--set", "source_voltage_pu=1.05")


@pytest.fixture(autouse=True)
def _elsewhere(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", "200")


def run(*arguments):
    main(["capacity", *SHORT, "--out", "out", *arguments])


@pytest.mark.slow
def test_it_prints_and_writes_the_same_answers(capsys, tmp_path):
    run(*IEEE33, "--controllers", "none,droop", "--buses", "6,18")
    printed = capsys.readouterr().out
    rows = list(csv.DictReader((tmp_path / "out/capacity.csv").read_text().splitlines()))
    assert [(row["controller"], row["bus"]) for row in rows] == [
        (name, bus) for name in ("snapshot", "none", "droop") for bus in ("6", "18")
    ]
    record = json.loads((tmp_path / "out/results.json").read_text())
    assert [c["capacity_mw"] for c in record["capacities"]] == [float(row["capacity_mw"]) for row in rows]
    assert record["meta"]["command"]
    assert (record["study"]["v_min_pu"], record["study"]["samples"]) == (0.95, 2)
    (line,) = [line for line in printed.splitlines() if line.split()[:1] == ["18"]]
    assert line.split()[1:3] == [f"{float(rows[i]['capacity_mw']):g}" for i in (1, 3)]
    assert (tmp_path / "out/capacity.png").read_bytes()[:4] == b"\x89PNG"
    assert "Ratings known for 0 of 32 elements; not checked: branch 1-2, " in printed
    assert record["ratings"]["known"] == 0
    assert len(record["ratings"]["not_checked"]) == 32


@pytest.mark.slow
def test_ratings_of_a_season_and_of_outages_are_asked_for_and_reported(tmp_path, capsys):
    feeder = load_feeder("ieee13-3ph")
    names = [f"line {name}" for name in feeder.network.phase_line.name]
    n = len(names)
    table = RatingTable(names, ["winter"] * n, [2000.0] * n, [2500.0] * n)
    type(feeder).from_network(replace(feeder.to_network(), rating=table)).to_csv(tmp_path / "rated")
    ask = ("--feeder", "rated", "--buses", "675", "--controllers", "none", "--limits", "0.8,1.2", "--season", "winter")
    run(*ask, "--outages", "all", "--outage-rating", "emergency", "--max-mw", "1", "--tolerance-mw", "0.5")
    known = len(feeder.network.phase_line) + len(feeder.network.transformer) + 1
    assert f"Ratings known for {known} of {known + 1} elements (winter, normal); limited" in capsys.readouterr().out
    record = json.loads((tmp_path / "out/results.json").read_text())
    assert record["ratings"]["basis"] == "winter, normal"
    assert "transformer sub" in record["ratings"]["otherwise"]
    assert (record["study"]["season"], record["study"]["outage_rating"]) == ("winter", "emergency")


def test_a_scenario_brings_its_devices_limits_and_all_buses(tmp_path):
    run("--scenario", "toy6", "--limits", "0.8,1.1", "--load", "peak", "--buses", "all", "--controller", "none")
    record = json.loads((tmp_path / "out/results.json").read_text())
    assert record["study"]["others"]
    assert len(record["study"]["buses"]) == 5
    assert record["study"]["load"] == "peak"


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ((), "feeder: must be given, or --scenario"),
        ((*IEEE33, "--controllers", ""), "must name at least one"),
        ((*IEEE33, "--controllers", "nobody"), "nobody"),
        ((*IEEE33, "--season", "winter"), "season is 'winter'; it is without seasons in ratings.csv"),
        ((*IEEE33, "--rating", "emergency"), "no emergency rating is known; add them in ratings.csv"),
        ((*IEEE33, "--outage-rating", "emergency"), "outage_rating: is 'emergency' without --outages"),
        (
            (*IEEE33, "--limits", "0.95"),
            "limits: must be the lowest and the highest voltage, such as 0.95,1.05, got '0.95'",
        ),
        ((*IEEE33, "--limits", "1.05,0.95"), "v_max_pu is 0.95; give a voltage above"),
        ((*IEEE33, "--buses", "18,1"), "the substation '1'"),
        ((*IEEE33, "--buses", "180"), "180"),
        ((*IEEE33, "--workers", "0"), "workers: must be at least 1, got 0"),
        ((*IEEE33, "--trace", "nothing"), "trace"),
        (("--feeder", "nowhere"), "nowhere"),
    ],
)
def test_what_cannot_be_is_one_line_and_nothing_is_written(arguments, said, capsys, tmp_path):
    with pytest.raises(SystemExit):
        run(*arguments)
    error = capsys.readouterr().err.strip()
    assert said in error
    assert len(error.splitlines()) == 1
    assert not (tmp_path / "out").exists()


@pytest.mark.slow
def test_outages_and_sites_together_are_printed_and_written(capsys, tmp_path):
    wide = ("--limits", "0.93,1.08", "--max-mw", "1", "--tolerance-mw", "0.1", "--controllers", "none")
    more = ("--outages", "capacitor c83, regulator reg4", "--together", "equal")
    run("--feeder", "ieee123-3ph", "--buses", "66,76", *wide, *more)
    printed = capsys.readouterr().out
    assert "with an outage" in printed
    assert "Sites at once, rule equal" in printed
    rows = (tmp_path / "out/outages.csv").read_text().splitlines()
    assert rows[0].startswith("outage,controller,bus,capacity_mw")
    assert {row.split(",")[0] for row in rows[1:]} == {"capacitor c83", "regulator reg4"}
    record = json.loads((tmp_path / "out/results.json").read_text())
    alone = {c["bus"]: c["capacity_mw"] for c in record["capacities"] if c["controller"] == "none"}
    (at_once,) = record["together"]
    assert all(mw <= alone[bus] for bus, mw in zip(at_once["buses"], at_once["mw"], strict=True))


@pytest.mark.parametrize(
    ("more", "message"),
    [
        (("--together", "sum"), "together: needs at least two buses in --buses, got None"),
        (("--outages", "capacitor x"), "the balanced feeder 'ieee33' has no elements"),
    ],
)
def test_outages_and_sites_that_cannot_be_asked(capsys, tmp_path, more, message):
    with pytest.raises(SystemExit):
        run(*IEEE33, *more)
    assert message in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


@pytest.mark.slow
@pytest.mark.parametrize("command", ["capacity", "study"])
def test_the_voltage_of_the_feeders_file_holds_and_is_stated(command, tmp_path, capsys):
    # A resistance to a bus of 1 MW: 1.03 p.u. at the source leave P = V (1.03 - V) / r for the voltage V at the bus.
    nodes = NodeTable(["s", "b"], [0, 0], [0.0, 1.0], [0.0, 0.0])
    lines = LineTable(["s"], ["b"], [2.0], [0.0])
    network = balanced_network(
        "pair", base_kv=10.0, substation="s", v0_pu=1.03, nodes=nodes, lines=lines, p_kw=[0.0, 1000.0],
        q_kvar=[0.0, 0.0], capacitor_kvar=[0.0, 0.0],
    )  # fmt: skip
    Feeder.from_network(network).to_csv(tmp_path / "pair")
    most_mw = 0.95 * (1.03 - 0.95) / (2.0 / 10.0**2) - 1.0
    if command == "capacity":
        run("--feeder", "pair", "--controllers", "none", "--load", "peak", "--tolerance-mw", "0.01")
        record = json.loads((tmp_path / "out/results.json").read_text())
        found = record
    else:
        (tmp_path / "s.toml").write_text(
            'feeder = "pair"\nbus = "b"\nmw = 1.0\ncontrollers = ["none"]\nleave_out = ["day", "fluctuation", '
            '"ride-through", "sensitivity", "worst-window"]\n'
            '[capacity]\nload = "peak"\nsamples = 2\nwindow_s = 10.0\nsettle_s = 4.0\ntolerance_mw = 0.01\n'
        )
        main(["study", "s.toml", "--out", "out", "--workers", "1"])
        record = json.loads((tmp_path / "out/report.json").read_text())
        found = record["capacity"]
        assert "Source at 1.03 p.u., from pair/feeder.toml." in (tmp_path / "out/report.html").read_text()
    printed = [line for line in capsys.readouterr().out.splitlines() if "━" not in line]
    assert printed[0] == record["source_voltage"] == "source at 1.03 p.u., from pair/feeder.toml"
    (snapshot,) = [c["capacity_mw"] for c in found["capacities"] if c["controller"] == "snapshot"]
    assert snapshot == pytest.approx(np.floor(100.0 * most_mw) / 100.0)


@pytest.mark.slow
def test_load_profiles_that_begin_where_the_user_sets_it_have_a_capacity(tmp_path, capsys):
    hours = "\n".join(f"2025-01-{1 + h // 24:02d} {h % 24:02d}:00,{0.5 + 0.5 * (h == 100)}" for h in range(240))
    load_feeder("toy6").to_csv(tmp_path / "mine")
    (tmp_path / "p.csv").write_text(f"time,all\n{hours}\n")
    (tmp_path / "c.csv").write_text("load,class\n" + "".join(f"{b},all\n" for b in load_feeder("toy6").bus_ids[1:]))
    fields = ("file=p.csv", "columns=class", "classes=c.csv", "uncovered=nominal", "days=all")
    changes = [f"load_profiles.{field}" for field in fields]
    for begin in ([], ["load_profiles.start_h=100.0"]):
        run("--feeder", "mine", "--controllers", "none", "--buses", "4", "--set", *changes, *begin)
    assert "source at 1 p.u., from mine/feeder.toml" in capsys.readouterr().out

"""The report of an import: one record behind the terminal, import_report.json and import_report.html."""

import hashlib
import json
import re

import numpy as np
import pytest

from dcgrid_env import Feeder, ThreePhaseFeeder, load_feeder
from dcgrid_env.apps.importers import import_page
from dcgrid_env.apps.importers.import_page import page
from dcgrid_env.apps.importers.import_record import Comparison, Difference, ImportRecord, RatedKind
from dcgrid_env.apps.importers.import_report import Finding
from dcgrid_env.apps.importers.matpower import write_matpower
from dcgrid_env.apps.importers.opendss import LossEffect
from dcgrid_env.cli.main import main
from helpers.html_files import Balanced
from helpers.opendss_text import script_of

dss = pytest.importorskip("opendssdirect", reason="OpenDSSDirect.py is not installed (extra opendss)")
LOST = """
New Line.rated bus1=680 bus2=r phases=3 r1=0.1 x1=0.1 normamps=400
New Line.default bus1=r bus2=d phases=3 r1=0.1 x1=0.1
New IndMach012.g<b>&bold bus1=680 kv=4.16 kw=300 kva=400
New ISource.i bus1=680 amps=1
New Load.off bus1=d kv=4.16 kw=90 model=8 zipv=(0 0 1 0 0 1 1.2)
New Recloser.x line.650632
CalcVoltageBases
"""


@pytest.fixture
def master(tmp_path):
    path = tmp_path / "Master.dss"
    path.write_text("\n".join(script_of(load_feeder("ieee13-3ph").network)) + LOST)
    return path


def solved_by_opendss(path, *commands):
    """Voltage magnitudes in V by node and power of the source in kW, after more commands and a solution."""
    engine = dss.dss.NewContext()
    for command in (f'redirect "{path}"', "set controlmode=off tolerance=1e-10 maxiterations=1000", *commands, "solve"):
        engine.Text.Command(command)
    engine.Circuit.SetActiveElement("vsource.source")
    power = -sum(engine.CktElement.Powers()[::2])
    return dict(zip(engine.Circuit.AllNodeNames(), engine.Circuit.AllBusVMag(), strict=True)), power


@pytest.mark.slow
def test_the_report_has_what_the_lost_elements_change(master, capsys, tmp_path):
    out = tmp_path / "my-feeder"
    main(["import", "opendss", str(master), "--out", str(out), "--allow", "indmach012,isource,load"])
    terminal = capsys.readouterr().out
    report = json.loads((out / "import_report.json").read_text())
    text = (out / "import_report.html").read_text()
    html = Balanced(text)
    assert "b" not in html.tags
    assert "g<b>&bold" in "".join(html.text)
    assert "script" not in html.tags
    assert not html.links
    assert report["format"] == "dcgrid import report 1"
    assert report["files"] == [{"name": "Master.dss", "sha256": hashlib.sha256(master.read_bytes()).hexdigest()}]
    assert report["files"][0]["sha256"] in text
    assert report["command"].startswith("dcgrid import opendss ")
    assert report["versions"]["OpenDSS"].startswith("DSS C-API")
    changes = {tuple(row["kinds"]): row for row in report["effects"]}
    assert set(changes) == {("indmach012",), ("isource",), ("load",), ("load", "indmach012", "isource")}
    edits = {"indmach012": 'disable "indmach012.g<b>&bold"', "isource": "disable isource.i",
             "load": "edit load.off zipv=(0 0 1 0 0 1 0)"}  # fmt: skip
    before, before_kw = solved_by_opendss(master)
    for kinds, row in changes.items():
        after, after_kw = solved_by_opendss(master, *(edits[kind] for kind in kinds))
        change = {node: after[node] - v for node, v in before.items()}
        bus, letter = row["node"].split(".")
        node = f"{bus}.{'abc'.index(letter) + 1}"
        assert abs(change[node]) == max(map(abs, change.values())) > 0.1
        assert row["change_v"] == pytest.approx(change[node], abs=1e-6)
        assert row["change_kw"] == pytest.approx(after_kw - before_kw, abs=1e-5)
        assert f"{row['change_v']:+.3g} V" in terminal
        assert f"{row['change_v']:+.3g}" in html.text
        assert f"{row['change_kw']:+.3g} kW" in terminal
    whole, without = report["comparisons"]
    assert whole["largest"][0]["difference_pu"] > 1e-3
    assert without["largest"][0]["difference_pu"] < 1e-8
    assert len(without["largest"]) == 5
    assert f"{whole['largest'][0]['difference_pu']:.1e} p.u.; largest at {whole['largest'][0]['node']}" in terminal
    assert "because of the omitted elements" in terminal
    np.testing.assert_equal(ThreePhaseFeeder.from_csv(out).n_bus, report["counts"]["buses"])
    [lines] = [row for row in report["ratings"] if row["kind"] == "line"]
    assert "default" in lines["not_known"]
    assert "rated" not in lines["not_known"]  # OpenDSS's default is 400 A too
    assert sum(row["known"] for row in report["ratings"]) == 4
    assert "ratings known for 4 of 17 elements" in terminal


@pytest.mark.slow
def test_elements_without_supply_are_named_once(master, capsys, tmp_path):
    master.write_text(master.read_text() + "\nNew Line.far bus1=x bus2=y\nNew Load.y bus1=y kv=4.16 kw=9\n")
    allow = "indmach012,isource,load,isolated"
    main(["import", "opendss", str(master), "--out", str(tmp_path / "out"), "--allow", allow])
    capsys.readouterr()
    report = json.loads((tmp_path / "out" / "import_report.json").read_text())
    fates = [(row["kind"], row["fate"]) for row in report["findings"] if {"far", "line far"} & set(row["names"])]
    assert fates == [("isolated", "lost")]
    [row] = [row for row in report["effects"] if row["kinds"] == ["isolated"]]
    assert row["number"] == 2
    assert abs(row["change_v"]) < 1e-6


@pytest.mark.slow
def test_every_file_that_is_read_is_listed(master, capsys, tmp_path):
    (tmp_path / "more.dss").write_text("New LoadShape.s npts=2 interval=1 mult=(file=day.csv)\n")
    (tmp_path / "day.csv").write_text("1\n0.5\n")
    master.write_text(master.read_text().replace(LOST, "\nRedirect more.dss\n"))
    main(["import", "opendss", str(master), "--out", str(tmp_path / "out")])
    assert "voltages differ" not in capsys.readouterr().out
    report = json.loads((tmp_path / "out" / "import_report.json").read_text())
    assert [row["name"] for row in report["files"]] == ["Master.dss", "more.dss", "day.csv"]
    assert report["effects"] == []
    assert len(report["comparisons"]) == 1
    assert "Nothing is lost, and both power flows agree." in (tmp_path / "out" / "import_report.html").read_text()


@pytest.mark.slow
def test_a_report_that_cannot_be_written_leaves_nothing(master, capsys, tmp_path, monkeypatch):
    def full(*_):
        raise OSError("no space left")

    monkeypatch.setattr(import_page, "page", full)
    with pytest.raises(SystemExit):
        main(
            ["import", "opendss", str(master), "--out", str(tmp_path / "a" / "o"), "--allow", "indmach012,isource,load"]
        )
    assert "no space left" in capsys.readouterr().err
    assert [path.name for path in tmp_path.iterdir()] == ["Master.dss"]


def test_balanced_imports_have_the_report_too(tmp_path, capsys):
    write_matpower(load_feeder("ieee33"), tmp_path / "case.m")
    main(["import", "matpower", str(tmp_path / "case.m"), "--out", str(tmp_path / "out")])
    terminal = capsys.readouterr().out
    report = json.loads((tmp_path / "out" / "import_report.json").read_text())
    html = Balanced((tmp_path / "out" / "import_report.html").read_text())
    assert report["files"][0]["name"] == "case.m"
    assert report["counts"] == {"buses": 33, "branches": 32}
    assert report["comparisons"][0]["largest"][0]["difference_pu"] < 1e-8
    assert f"{report['comparisons'][0]['largest'][0]['difference_pu']:.1e}" in html.text
    assert "33 buses, 32 branches, 3715.0 kW at 12.66 kV" in terminal
    assert "33 buses, 32 branches, 3715.0 kW at 12.66 kV" in "".join(html.text)
    assert Feeder.from_csv(tmp_path / "out").n_bus == 33


def record(**changes):
    near = (Difference("n.a", 3e-3, 20.0),)
    fields = {
        "feeder": "</title><script>", "source": "<i>", "files": (("<a>.dss", "0" * 64),), "command": "dcgrid <x>",
        "versions": {"numpy": None}, "counts": {"buses": 2}, "load_kw": 1.0, "base_kv": 4.16,
        "findings": (Finding("<u>", ("<s>",) * 9, "lost", "<q>"),),
        "effects": (LossEffect(("<u>",), 9, "", *[float("nan")] * 4),),
        "comparisons": (Comparison("<c>", "OpenDSS", near), Comparison("without", "OpenDSS", near)),
        "ratings": (RatedKind("<k>", 0, 9, ("<n>",) * 9),), "notes": ("<m>",),
    }  # fmt: skip
    return ImportRecord(**fields | changes)


def test_every_text_is_escaped_and_unknown_figures_are_none():
    html = Balanced(page(record()))
    assert not html.tags & {"script", "i", "a", "x", "u", "s", "q", "c", "k", "n", "m"}
    assert "not known" in html.text
    assert record().as_json()["effects"][0]["change_v"] is None
    assert any("OpenDSS finds no solution without" in line for line in record().lines)


def test_a_difference_that_losses_do_not_explain_is_named():
    assert "also without the omitted elements; the tables may be wrong" in record().verdicts[0]
    good = (record().comparisons[0], Comparison("without", "OpenDSS", (Difference("n.a", 1e-9, 0.0),)))
    assert record(comparisons=good).verdicts == (
        "voltages differ by more than 1e-06 p.u. because of the omitted elements",
    )
    alone = record(findings=(), comparisons=record().comparisons[:1])
    assert "although no element was omitted; the tables may be wrong" in alone.verdicts[0]
    none = Comparison("c", "OpenDSS", (), ("dcgrid",))
    assert record(comparisons=(none,)).verdicts == ()
    assert re.search(r"not compared: no power flow solution from dcgrid", page(record(comparisons=(none,))))

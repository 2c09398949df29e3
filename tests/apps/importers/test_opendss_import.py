"""``dcgrid import opendss`` in a terminal: a folder, a table and a comparison, or one line and nothing written."""

import numpy as np
import pytest

from dcgrid_env import ThreePhaseFeeder, load_feeder, profile_coverage, scenario_on
from dcgrid_env.cli.main import main
from dcgrid_env.grid.formats import feeder_folder
from helpers.opendss_text import script_of

dss = pytest.importorskip("opendssdirect", reason="OpenDSSDirect.py is not installed (extra opendss)")


@pytest.fixture
def master(tmp_path):
    path = tmp_path / "Master.dss"
    path.write_text("\n".join(script_of(load_feeder("ieee13-3ph").network)))
    return path


def said(capsys, *words):
    """Status and output of a command that fails with one line."""
    with pytest.raises(SystemExit) as ended:
        main(["import", "opendss", *map(str, words)])
    err = capsys.readouterr().err
    assert ended.value.code == 2
    assert err.startswith("dcgrid: ")
    assert err.count("\n") == 1
    return err


@pytest.mark.slow
def test_a_feeder_is_written_and_compared(master, capsys):
    out = master.parent / "new" / "my-feeder"
    main(["import", "opendss", str(master), "--out", str(out)])
    text = capsys.readouterr().out
    assert "regcontrol" in text
    assert "largest voltage difference from OpenDSS" in text
    assert "differ by more than" not in text
    assert "ratings known for 3 of 15 elements; not checked: line 650632, " in text
    assert f"wrote {out}: " in text
    feeder = ThreePhaseFeeder.from_csv(out)
    assert set(feeder.node_ids) == set(load_feeder("ieee13-3ph").node_ids)
    assert sorted(path.name for path in master.parent.iterdir()) == ["Master.dss", "new"]


@pytest.mark.slow
def test_what_is_lost_is_said_with_the_difference_that_it_makes(master, capsys):
    master.write_text(
        master.read_text() + "\nNew IndMach012.g bus1=680 kv=4.16 kw=300 kva=400\nNew ISource.i bus1=680 amps=0.1"
    )
    out = master.parent / "my-feeder"
    assert "--allow indmach012,isource accepts" in said(capsys, master, "--out", out)
    assert not out.exists()
    main(["import", "opendss", str(master), "--out", str(out), "--allow", "indmach012, isource"])
    text = capsys.readouterr().out
    assert "p.u. because of the omitted elements" in text
    assert "lost: what it injects" in text


@pytest.mark.slow
def test_a_power_flow_that_opendss_does_not_find_is_said(master, capsys):
    master.write_text(master.read_text() + "\nEdit Load.671 kw=1e7 vminpu=0.002 vlowpu=0.001")
    assert "voltages are not compared: no power flow solution from " in said(
        capsys, master, "--out", master.parent / "out"
    )


@pytest.mark.slow
def test_an_existing_folder_is_taken_only_if_it_is_empty(master, capsys):
    out = master.parent / "there"
    out.mkdir()
    main(["import", "opendss", str(master), "--out", str(out)])
    capsys.readouterr()
    np.testing.assert_equal((out / "feeder.toml").exists(), True)
    assert "out: must be a new or empty folder" in said(capsys, master, "--out", out)
    assert "out: must be a new or empty folder" in said(capsys, master, "--out", master)


@pytest.mark.slow
def test_errors_are_one_line_and_leave_nothing(master, capsys, monkeypatch):
    out = master.parent / "a" / "out"
    assert "there is no file" in said(capsys, master.parent / "none.dss", "--out", out)
    assert "'fuses' is no kind of loss" in said(capsys, master, "--out", out, "--allow", "fuses")
    whole = master.read_text()
    master.write_text(f"{whole}\nDOScmd ls")
    assert "'DOScmd' is refused" in said(capsys, master, "--out", out)
    master.write_text(f"{whole}\nNew Load.twice bus1=671.1.1 phases=1 kv=2.4 kw=9")
    assert "load twice: its nodes 1.1 give no separate legs" in said(capsys, master, "--out", out)
    master.write_text(whole)

    def full(*_):
        raise OSError("no space left")

    monkeypatch.setattr(feeder_folder, "write_text", full)
    assert "no space left" in said(capsys, master, "--out", out)
    assert [path.name for path in master.parent.iterdir()] == ["Master.dss"]


@pytest.mark.slow
def test_load_shapes_become_files_of_profiles(master, capsys):
    shapes = "New LoadShape.day npts=3 interval=8 mult=(0.5 1 0.75)\nBatchEdit Load..* daily=day\n"
    master.write_text(f"{master.read_text()}\n{shapes}")
    out = master.parent / "my-feeder"
    main(["import", "opendss", str(master), "--out", str(out)])
    text = capsys.readouterr().out
    assert "in load_profiles_daily.csv" in text
    lines = (out / "load_profiles_daily.csv").read_text().splitlines()
    assert lines[0].startswith("# load shapes of OpenDSS's mode daily")
    assert lines[1:3] == ["time_s,day", "0,0.75"]  # at midnight the last point
    assert len(lines) == 2 + 24
    profiles = {"file": out / "load_profiles_daily.csv", "classes": out / "load_classes_daily.csv", "columns": "class"}
    s = scenario_on(ThreePhaseFeeder.from_csv(out)).replace(load_profiles=profiles | {"days": "repeat"})
    assert profile_coverage(s).without == ()

"""``dcgrid import`` and ``export`` of balanced grids in a terminal: a folder or file and a comparison, or one line."""

import json
from typing import Any

import pytest

from dcgrid_env import Feeder, load_feeder, scenario_on
from dcgrid_env.apps.importers.matpower import write_matpower
from dcgrid_env.cli.main import main

pytest.importorskip("pandapower", reason="pandapower is not installed (extra pandapower)")
pytest.importorskip("power_grid_model", reason="power-grid-model is not installed (extra power-grid-model)")
pytestmark = pytest.mark.filterwarnings("ignore")  # pandapower's own, as its nets are made
SUFFIX = {"pandapower": "json", "matpower": "m", "power-grid-model": "json"}


def said(capsys, *words):
    """What a command that fails says, in one line."""
    with pytest.raises(SystemExit) as ended:
        main([*map(str, words)])
    err = capsys.readouterr().err
    assert ended.value.code == 2
    assert err.startswith("dcgrid: ")
    assert err.count("\n") == 1
    return err


@pytest.mark.parametrize("kind", SUFFIX)
@pytest.mark.slow
def test_a_feeder_goes_out_and_comes_in(tmp_path, capsys, kind):
    file, out = tmp_path / "deep" / f"grid.{SUFFIX[kind]}", tmp_path / "my-feeder"
    main(["export", kind, "ieee33", "--out", str(file)])
    text = capsys.readouterr().out
    assert "largest voltage difference" in text
    assert "differ by more" not in text
    assert f"wrote {file}: 33 buses, 32 branches" in text
    main(["import", kind, str(file), "--out", str(out)])
    text = capsys.readouterr().out
    assert "one branch" in text
    assert "differ by more" not in text
    assert f"wrote {out}: 33 buses, 32 branches, 3715.0 kW at 12.66 kV" in text
    assert Feeder.from_csv(out).n_bus == 33
    assert sorted(path.name for path in tmp_path.iterdir()) == ["deep", "my-feeder"]
    assert "choose another --out" in said(capsys, "export", kind, "ieee33", "--out", file)
    assert "choose another --out" in said(capsys, "import", kind, file, "--out", out)


@pytest.mark.slow
def test_a_named_net_is_made_with_arguments_and_a_case_is_known_by_its_path(tmp_path, capsys):
    words = ["create_cigre_network_mv", "--arguments", "with_der=all"]
    main(["import", "pandapower", *words, "--out", str(tmp_path / "a")])
    assert "storage" in capsys.readouterr().out
    write_matpower(load_feeder("ieee33"), tmp_path / "case.m")
    main(["import", "pandapower", str(tmp_path / "case.m"), "--out", str(tmp_path / "b")])
    assert "MATPOWER's power flow" in capsys.readouterr().out


def test_buses_that_switches_join_are_listed_beside_the_tables(tmp_path, capsys):
    main(["export", "power-grid-model", "ieee123", "--out", str(tmp_path / "grid.json")])
    main(["import", "power-grid-model", str(tmp_path / "grid.json"), "--out", str(tmp_path / "a")])
    capsys.readouterr()
    rows = (tmp_path / "a" / "merged_buses.csv").read_text().splitlines()
    assert rows[0] == "source_bus,bus"
    assert len(rows) > 1
    assert Feeder.from_csv(tmp_path / "a").n_bus == load_feeder("ieee123").n_bus - (len(rows) - 1)


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (["pandapower", "case4gs"], "gen 0: it keeps a voltage"),
        (["pandapower", "case33bx"], "'case33bx' is no network of pandapower's"),
        (["pandapower", ""], "net: must not be empty"),
        (
            ["pandapower", "case33bw", "--arguments", "7"],
            "arguments: must be NAME=VALUE, such as with_der=all, got '7'",
        ),
        (["pandapower", "mv_oberrhein.json"], "cannot be read"),
        (["matpower", "missing.m"], "cannot be read (No such file or directory); give a MATPOWER case file"),
        (["matpower", "."], "cannot be read (Is a directory)"),
        (["power-grid-model", "missing.json"], "cannot be read (No such file or directory)"),
    ],
)
def test_what_cannot_be_imported_leaves_nothing(tmp_path, capsys, monkeypatch, words, told):
    monkeypatch.chdir(tmp_path)
    assert told in said(capsys, "import", *words, "--out", "new/folder")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (["matpower", "ieee123"], "branch 18-135 has no impedance"),
        (["pandapower", "ieee13-3ph"], "feeder: must be balanced, got ieee13-3ph with three phases"),
        (["pandapower", "nowhere"], "nowhere"),
        (["pandapower", " "], "feeder: must not be empty"),
    ],
)
def test_what_cannot_be_exported_leaves_nothing(tmp_path, capsys, monkeypatch, words, told):
    monkeypatch.chdir(tmp_path)
    assert told in said(capsys, "export", *words, "--out", "new/grid.x")
    assert list(tmp_path.iterdir()) == []


def test_a_file_of_another_program_is_said_to_be_none(tmp_path, capsys):
    (tmp_path / "grid.json").write_text(json.dumps({"data": {}}))
    for kind in ("pandapower", "power-grid-model"):
        assert "is no" in said(capsys, "import", kind, tmp_path / "grid.json", "--out", tmp_path / "x")


@pytest.mark.slow
def test_profiles_of_a_net_become_a_file(tmp_path, capsys):
    import pandapower
    import pandapower.networks
    import pandas

    net: Any = pandapower.networks.case33bw()
    net.load["profile"] = "H0"
    net["profiles"] = {"load": pandas.DataFrame({"H0_pload": [0.5, 1.0], "H0_qload": [0.25, 1.0]})}
    pandapower.to_json(net, str(tmp_path / "net.json"))
    main(["import", "pandapower", str(tmp_path / "net.json"), "--out", str(tmp_path / "a")])
    assert "profile of load" in capsys.readouterr().out
    profiles = {"file": tmp_path / "a/load_profiles.csv", "columns": "bus", "unit": "kw", "uncovered": "nominal"}
    feeder = Feeder.from_csv(tmp_path / "a")
    s = scenario_on(feeder).replace(load_profiles=profiles | {"days": "all"}, horizon=10)
    table = s.load_profiles.table
    assert table.values[0, table.names.index("1")] == 50.0  # half of 100 kW
    assert table.values[0, table.names.index("1.q")] == 15.0

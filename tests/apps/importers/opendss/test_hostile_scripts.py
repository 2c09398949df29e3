"""Untrusted scripts must not control OpenDSS: dangerous commands are refused by file, line and command."""

import os

import pytest

from dcgrid_env import FeederError
from dcgrid_env.apps.importers.opendss.reading import read_circuit
from dcgrid_env.apps.importers.opendss.script_rules import _DANGEROUS, _SUSPECT, BY_POSITION, HARMLESS_POSITIONS

dss = pytest.importorskip("opendssdirect", reason="OpenDSSDirect.py is not installed (extra opendss)")
SHAPE = "New LoadShape.s npts=2 interval=1"
GENERATOR = "New Generator.g bus1=n kv=12.47 kw=1 kvar=0"


@pytest.mark.parametrize("line", [
    "DOScmd rm -rf x", "dosc ls", "CD ..", "Formedit Line.l1", "Set log=yes", "e voltages",
    "Set rec=yes", "Set mode=yearly", "Solve mode=daily number=10", "Set autobuslist=(file=x)",
    "var @a=Export", "? Line.l1.r1", "Quit", "MakePosSeq", "Reduce", "Obfuscate", "NewActor", "nonsense", "kw=3",
    "UUIDs file=x", "ExportOverloads", "Set 12", "s Line.l1", "re x.dss", "com x.dss", "Wait", "Clone 4", "COMHelp",
])  # fmt: skip
def test_commands_and_options_that_are_refused(master, line):
    path = master(line)
    with pytest.raises(FeederError, match=rf"Master.dss, line 9: '{line.split()[0].replace('?', '.')}' is refused"):
        read_circuit(path)


@pytest.mark.parametrize("line", [
    f"{GENERATOR} usermodel=x.so", f"{GENERATOR} UserM=x.so", f"{GENERATOR}\n~ shaftmodel=x", f"{GENERATOR} u=x",
    f"{GENERATOR}\nGenerator.g.UserModel=x", f"{GENERATOR}\nEdit Generator.g userdata=(file=x)",
    f"{GENERATOR}\nBatchEdit Generator..* usermodel=x",
    "New Generator.g 3 n 12.47", "New Storage.b bus1=n DynaDLL=x", "New PVSystem.p bus1=n usermodel=x",
    "New CapControl.c usermodel=x", "New RegControl.r debugt=yes", f"{SHAPE} action=DblSave", f"{SHAPE} act=D",
    f"{SHAPE} action=S", f"{SHAPE} csvfile=/etc/passwd", f"{SHAPE} csvf=x", f"{SHAPE} mult=(file=/etc/passwd)",
    f"{SHAPE} mult=(file=../x.csv)", f"{SHAPE} mult=[sngfile=/dev/zero]", f"{SHAPE} mult=\"file=x\"",
    f"{SHAPE} mult=(1 file=x)", f"{SHAPE} mult=(db=x)", "Set voltagebases=(fi=x)", "Open Line.l1 (file=x)",
    "New EnergyMeter.m element=line.l1 action=save", "New Monitor.m Line.l1 1 save",
    "New EnergyMeter.m terminal=1 save",
    "New Spectrum.s csvfile=~/x", "~ kw=3\nSelect Load.d\n~ kw=2", "New NoClass.x", "New LineCode",
    "New Load.x bus1=n kw=(file=/etc/passwd)", "New XYCurve.c npts=2 csvfile=C:\\x.csv", "Load.d.file=x",
])  # fmt: skip
def test_properties_that_are_refused(master, line):
    with pytest.raises(FeederError, match=r"Master.dss, line (9|1\d): '[^']+' is refused: .*--trust"):
        read_circuit(master(line))


@pytest.mark.parametrize("line", [
    "Redirect /etc/passwd", "Compile ../outside.dss", "Redirect link.dss", "Redirect linked/outside.dss",
    "BusCoords ../outside.dss", "Redirect ..\\outside.dss", "Redirect .", "Redirect pipe", "Redirect missing.dss",
    "LatLongCoords /etc/passwd", "Redirect a.dss b.dss", "Redirect",
])  # fmt: skip
def test_files_beyond_the_masters_folder_are_refused(tmp_path, master, line):
    home = tmp_path / "home"
    home.mkdir()
    (tmp_path / "outside.dss").write_text("New Load.x bus1=n kv=12.47 kw=1\n")
    (home / "link.dss").symlink_to(tmp_path / "outside.dss")
    (home / "linked").symlink_to(tmp_path)
    os.mkfifo(home / "pipe")
    path = master(line).rename(home / "Master.dss")
    with pytest.raises(FeederError, match=r"Master.dss, line 9: .* is refused"):
        read_circuit(path)
    if "outside" in line and ".." in line and "BusCoords" not in line and "\\" not in line:
        assert "x" in read_circuit(path, trust=True).network.phase_load.name


NEEDS = {"regcontrol": "transformer=t winding=2", "capcontrol": "capacitor=c element=line.l1 type=voltage"}
NEEDS |= dict.fromkeys(("relay", "fuse"), "monitoredobj=line.l1") | {"swtcontrol": "switchedobj=line.l1"}
NEEDS |= dict.fromkeys(("gendispatcher", "storagecontroller", "espvlcontrol", "monitor"), "element=line.l1")


def test_no_property_of_opendss_that_may_stand_by_position_names_a_file_or_acts():
    engine = dss.dss.NewContext()
    before = ("Clear", "New Circuit.c", "New Line.l1", "New Transformer.t", "New Capacitor.c")
    for command in before:
        engine.Text.Command(command)
    seen = set()
    for kind in map(str.lower, engine.Basic.Classes()):
        engine.Text.Command(f"New {kind}.one {NEEDS.get(kind, '')}")
        engine.Circuit.SetActiveElement(f"{kind}.one")
        names = [name.lower() for name in engine.Element.AllPropertyNames()]
        dangerous = [k for k, name in enumerate(names) if name in _DANGEROUS or _SUSPECT.search(name)]
        assert all(k >= HARMLESS_POSITIONS for k in dangerous), kind
        assert not dangerous or kind not in BY_POSITION, kind
        seen |= {names[k] for k in dangerous}
    assert seen == set(_DANGEROUS)


@pytest.mark.slow
def test_scripts_that_redirect_to_themselves_end(tmp_path, master):
    with pytest.raises(FeederError, match="redirect deeper than 32"):
        read_circuit(master("Redirect Master.dss"))


@pytest.mark.slow
def test_a_refusal_in_a_redirected_file_names_that_file(tmp_path, master):
    (tmp_path / "sub").mkdir()
    (tmp_path / "sub" / "loads.dss").write_text("! loads\nDOScmd ls\n")
    with pytest.raises(FeederError, match=r"loads.dss, line 2: 'DOScmd' is refused: 'doscmd' is not part of"):
        read_circuit(master("Redirect sub/loads.dss"))


def test_nothing_is_written_and_the_folder_stays(tmp_path, master, monkeypatch):
    monkeypatch.chdir(tmp_path)
    read_circuit(master("Solve"))
    assert [path.name for path in tmp_path.iterdir()] == ["Master.dss"]
    shown = ("eXpOrT voltages out.csv", "Save circuit dir=out", "sho volt", "Dump", "FileEdit Master.dss", "Visualize",
             "Set editor=/bin/sh", "Set recorder=yes", "Set casename=x")  # fmt: skip
    read_circuit(master("\n".join(shown)))
    assert [path.name for path in tmp_path.iterdir()] == ["Master.dss"]


def test_trust_runs_the_script_as_it_is(tmp_path, master, monkeypatch):
    monkeypatch.chdir(tmp_path)
    read_circuit(master("Solve\nExport voltages out.csv"), trust=True)
    assert any(path.name.endswith("out.csv") for path in tmp_path.iterdir())


def test_files_of_figures_beneath_the_folder_are_read(tmp_path, master):
    (tmp_path / "Sub Folder").mkdir()
    (tmp_path / "Sub Folder" / "Day.csv").write_text("1\n0.5\n")
    (tmp_path / "Sub Folder" / "More.DSS").write_text(
        f"{SHAPE} mult=(file=day.CSV)\nNew LoadShape.t npts=2 interval=1 csvfile=day.csv\nLoad.d.daily=s\n"
    )
    (tmp_path / "xy.csv").write_text("src, 1, 2\nm 3 4\n")
    found = read_circuit(master('Redirect "sub folder\\more.dss"', end="\nSet voltageb=12.47\ncalcv\nbusc xy.csv\n"))
    assert any("load_profiles_daily.csv" in row.text for row in found.findings)
    assert dict(zip(found.network.node.bus, found.network.node.x, strict=True))["m"] == 3.0


def test_block_comments_abbreviations_and_case_count_as_in_opendss(master):
    found = read_circuit(master("/* Export voltages\nShow */\nBATCHED Load..* kw=200\nLoad.d.kvar=50\nsolve\n"))
    assert (
        found.network.phase_load.p_kw == ((200 / 3,) * 3,) or abs(found.network.phase_load.p_kw[0][0] - 200 / 3) < 1e-9
    )
    assert abs(found.network.phase_load.q_kvar[0][0] - 50 / 3) < 1e-9


def test_commands_that_show_results_are_left_out_and_named(master):
    more = (
        "Show Voltages LN Nodes\nPlot Profile\nExport Powers\nAddBusMarker Bus=n code=5 color=Red\nSet DataPath=/tmp\n"
    )
    found = read_circuit(master(more + "New EnergyMeter.m line.l1 1 action=C debugtrace=yes"))
    skipped = [name for row in found.findings if row.kind == "command" for name in row.names]
    assert [name.partition(" (")[0] for name in skipped] == [
        "show", "plot", "export", "addbusmarker", "set datapath", "debugtrace"
    ]  # fmt: skip
    assert all("Master.dss, line" in name for name in skipped)


def test_files_of_a_root_folder_are_read_and_others_are_not(master, tmp_path):
    (tmp_path / "codes.dss").write_text("New Linecode.own r1=1 x1=1")
    folder = tmp_path / "circuit"
    folder.mkdir()
    script = master("Redirect ../codes.dss\nNew Line.o bus1=n bus2=o linecode=own length=1")
    moved = script.rename(folder / script.name)
    with pytest.raises(
        FeederError, match=r"not beneath the folder .*; put it there, or give a folder with both by --root"
    ):
        read_circuit(moved)
    assert "o" in read_circuit(moved, root=tmp_path).network.phase_line.name
    with pytest.raises(FeederError, match="is not beneath the root folder"):
        read_circuit(moved, root=tmp_path / "elsewhere")

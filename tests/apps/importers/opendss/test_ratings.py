"""Ratings out of OpenDSS scripts: which are written, and loadings against OpenDSS's own currents over its ratings."""

import dataclasses
import math

import numpy as np
import pytest

from dcgrid_env import ThreePhaseFeeder, branch_loading, scenario_hash
from dcgrid_env.apps.importers.opendss.reading import read_circuit
from dcgrid_env.powerflow import solve_unbalanced
from helpers.three_phase import ieee13

CODES = """
New Linecode.plain nphases=3 units=km r1=0.3 x1=0.4 r0=0.6 x0=1.2 c1=0 c0=0
New Linecode.rated like=plain normamps=400
New Linecode.alike like=rated
New Linecode.emergency like=plain emergamps=600
New Wiredata.bare gmr=0.0255 diam=0.741 rac=0.306 runits=mi gmrunits=ft radunits=in
New Wiredata.thick gmr=0.0255 diam=0.741 rac=0.306 normamps=400 runits=mi gmrunits=ft radunits=in
New Linegeometry.poles nconds=3 nphases=3 cond=1 wire=thick x=0 h=30 units=ft cond=2 wire=thick x=3 h=30
~ cond=3 wire=thick x=6 h=30
New Linegeometry.trees nconds=3 nphases=3 cond=1 wire=bare x=0 h=30 units=ft cond=2 wire=bare x=3 h=30
~ cond=3 wire=bare x=6 h=30
"""
WAYS = {
    "linecode=plain": None,
    "": None,
    "normamps=400": 400.0,
    "normamps=399": 399.0,
    "linecode=plain normamps=400": 400.0,
    "linecode=plain normamps=400 emergamps=600": 400.0,
    "normamps=350 linecode=plain": None,
    "linecode=rated": 400.0,
    "linecode=alike": 400.0,
    "linecode=emergency": 600.0,
    "emergamps=600": 600.0,
    "geometry=poles units=km": 400.0,
    "geometry=trees units=km": None,
    "switch=yes normamps=400": 400.0,
    "switch=yes": None,
}
"""What a script says of a line, and the rating that it gives, A."""


def lines(master, ways, more=""):
    rows = [f"New Line.w{k} bus1=b{k} bus2=b{k + 1} {way}" for k, way in enumerate(ways)]
    script = CODES + "\n".join(["New Line.w bus1=m bus2=b0 linecode=plain", *rows, more, ""])
    return read_circuit(master(script))


def rating(network, name):
    for table in (network.phase_line, network.switch):
        if name in table.name:
            amps = table.rating_a[table.name.index(name)] if table.rating_a else math.nan
            return None if math.isnan(amps) else amps
    raise AssertionError(name)


def test_a_rating_is_kept_where_the_script_writes_it_and_only_there(master):
    network = lines(master, WAYS).network
    assert {way: rating(network, f"w{k}") for k, way in enumerate(WAYS)} == WAYS


def test_a_rating_is_found_behind_like_and_edits(master):
    edits = """New Line.like0 like=w0 bus1=m bus2=c0
New Line.like1 like=w1 bus1=c0 bus2=c1
New Line.edited bus1=c1 bus2=c2
Edit Line.edited normamps=400
Line.w2.normamps=400
"""
    imported = lines(master, ["linecode=plain", "linecode=rated", "linecode=plain", "emergamps=700"], edits)
    found = {name: rating(imported.network, name) for name in ("like0", "like1", "edited", "w2", "w3")}
    assert found == {"like0": None, "like1": 400.0, "edited": 400.0, "w2": 400.0, "w3": 700.0}
    (said,) = [row for row in imported.findings if "emergamps" in row.text]
    assert (said.kind, said.names) == ("line", ("w3",))


def test_a_script_that_is_only_run_on_trust_keeps_every_rating_and_says_so(master, tmp_path):
    refused = "cd " + str(tmp_path)
    imported = read_circuit(master(CODES + f"New Line.w0 bus1=m bus2=b linecode=plain\n{refused}\n"), trust=True)
    assert rating(imported.network, "w0") == 400.0
    assert any("w0" in row.names and "cannot be told" in row.text for row in imported.findings)


def test_lines_side_by_side_are_rated_as_their_currents_divide(master):
    script = """New Line.p bus1=m bus2=b linecode=c3 length=1 units=km normamps=300
New Line.q bus1=m bus2=b linecode=c3 length=1 units=km normamps=200
New Line.r bus1=b.1 bus2=d.1 r1=1 x1=1 r0=1 x0=1 c1=0 c0=0 phases=1 length=1 normamps=70
New Line.s bus1=b.2 bus2=d.2 r1=1 x1=1 r0=1 x0=1 c1=0 c0=0 phases=1 length=1 normamps=60
New Line.t bus1=m bus2=e linecode=c3 length=1 units=km normamps=300
New Line.u bus1=m bus2=e linecode=c3 length=1 units=km
"""
    network = read_circuit(master(script)).network
    assert rating(network, "p+q") == pytest.approx(400.0)  # half of the current each
    assert rating(network, "r+s") == 60.0
    assert rating(network, "t+u") is None


CIRCUIT = """
Clear
New Circuit.station basekv=69 pu=1.03 bus1=src MVAsc3=3000 MVAsc1=2500
New Transformer.sub phases=3 buses=(src m) conns=(delta wye) kvs=(69 12.47) kvas=(5000 4500) xhl=8 %r=0.5
New Line.l1 bus1=m bus2=n phases=3 r1=0.3 x1=0.4 r0=0.6 x0=1.2 c1=0 c0=0 length=3 normamps=210
New Transformer.reg1 phases=1 buses=(n.1 o.1) kvs=(7.2 7.2) kvas=(900 900) xhl=0.01 %loadloss=0.01 wdg=2 tap=1.0625
New Transformer.reg2 phases=1 buses=(n.2 o.2) kvs=(7.2 7.2) kvas=(900 900) xhl=0.01 %loadloss=0.01 wdg=2 tap=0.9625
New Transformer.reg3 phases=1 buses=(n.3 o.3) kvs=(7.2 7.2) kvas=(900 900) xhl=0.01 %loadloss=0.01 wdg=2 tap=1.05
New Regcontrol.c1 transformer=reg1 winding=2 vreg=122 band=2 ptratio=60
New Regcontrol.c2 transformer=reg2 winding=2 vreg=122 band=2 ptratio=60
New Regcontrol.c3 transformer=reg3 winding=2 vreg=122 band=2 ptratio=60
New Transformer.low phases=3 buses=(o p) conns=(wye wye) kvs=(12.47 0.48) kvas=(500 500) taps=(0.95 1.025) xhl=4 %r=1
New Transformer.own phases=3 buses=(o q) conns=(wye wye) kvs=(12.47 0.48) kvas=(500 500) normhkva=450 xhl=4 %r=1
New Transformer.any phases=3 buses=(o s) conns=(wye wye) kvs=(12.47 0.48) xhl=4 %r=1
New Load.a bus1=p kv=0.48 kw=390 kvar=120
New Load.b bus1=q kv=0.48 kw=300 kvar=100
New Load.d bus1=o.1 phases=1 kv=7.2 kw=700 kvar=250
New Load.e bus1=o.3 phases=1 kv=7.2 kw=300 kvar=50
New Load.f bus1=s kv=0.48 kw=30 kvar=5
"""
VOLTAGES = "Set VoltageBases=[69 12.47 0.48]\nCalcVoltageBases\n"
RATED = {"sub": (69.0, 12.47, 4500.0), "low": (12.47, 0.48, 500.0), "own": (12.47, 0.48, 450.0)}
"""Rated voltages, kV, and the rating of the smaller winding, kVA."""


def test_loadings_are_opendss_currents_over_the_ratings(master):
    dss = pytest.importorskip("opendssdirect").dss.NewContext()
    path = master("", circuit=CIRCUIT, end=VOLTAGES)
    imported = read_circuit(path)
    feeder = ThreePhaseFeeder.from_network(imported.network)
    ours = branch_loading(feeder, solve_unbalanced(feeder, feeder.p_load_kw, feeder.q_load_kvar))

    def loading(name):
        fed = next(k + 1 for k, called in enumerate(feeder.branch_names) if name in called)
        return ours[feeder.first_node[fed] : feeder.first_node[fed + 1]]

    dss.Text.Command(f'redirect "{path}"')
    dss.Text.Command("set controlmode=off tolerance=1e-10 maxiterations=1000")
    dss.Solution.Solve()

    def amps(element, phases):
        dss.Circuit.SetActiveElement(element)
        flat = np.array(dss.CktElement.CurrentsMagAng())[::2]
        ends = flat.reshape(2, -1)
        return ends[0, :phases], ends[1, :phases]

    dss.Circuit.SetActiveElement("line.l1")
    assert dss.CktElement.NormalAmps() == 210.0
    np.testing.assert_allclose(loading("line l1"), amps("line.l1", 3)[1] / 210.0, rtol=1e-6)
    for name, (kv_from, kv_to, kva) in RATED.items():
        before, after = amps(f"transformer.{name}", 3)
        expected = after / (kva / math.sqrt(3.0) / kv_to)
        if name != "sub":  # in a delta the current of a winding is not that of the line
            expected = np.maximum(expected, before / (kva / math.sqrt(3.0) / kv_from))
        np.testing.assert_allclose(loading(f"transformer {name}"), expected, rtol=1e-4)
    at_regulators = [max(end[0] for end in amps(f"transformer.reg{k}", 1)) / (900.0 / 7.2) for k in (1, 2, 3)]
    np.testing.assert_allclose(loading("regulator"), at_regulators, rtol=1e-3)
    assert feeder.rating_a is not None
    bus = feeder.index("s")
    assert np.isnan(feeder.rating_a[feeder.first_node[bus] : feeder.first_node[bus + 1]]).all()
    assert not loading("transformer any").any()


def test_ratings_are_written_and_read_again(master, tmp_path):
    feeder = ThreePhaseFeeder.from_network(read_circuit(master("", circuit=CIRCUIT, end=VOLTAGES)).network)
    feeder.to_csv(tmp_path / "folder")
    again = ThreePhaseFeeder.from_csv(tmp_path / "folder")
    for table in ("phase_line", "switch", "transformer", "regulator"):
        assert repr(getattr(again.network, table)) == repr(getattr(feeder.network, table))
    assert "rating_kva_per_phase" not in (tmp_path / "folder/regulators.csv").read_text()  # it is kva_per_phase
    np.testing.assert_array_equal(again.rating_a, feeder.rating_a)


def test_a_rating_in_kva_changes_the_fingerprint_only_where_it_is_given():
    scenario = ieee13()
    network = scenario.feeder.network
    smaller = dataclasses.replace(network.transformer, rating_kva=[100.0] * len(network.transformer))
    feeder = ThreePhaseFeeder.from_network(dataclasses.replace(network, transformer=smaller))
    assert scenario_hash(scenario.replace(feeder=feeder)) != scenario_hash(scenario)
    assert feeder.rating_a is not None
    assert scenario.feeder.rating_a is not None
    assert np.nanmin(feeder.rating_a / scenario.feeder.rating_a) < 1.0

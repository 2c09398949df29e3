"""pandapower's nets: voltages are those of its power flow, what cannot be is refused by name, and nets come back."""

import json
import logging

import numpy as np
import pytest

from dcgrid_env import Feeder, FeederError, forecast, load_feeder, scenario_on
from dcgrid_env.apps.importers.pandapower import pandapower_net, read_pandapower, write_pandapower
from dcgrid_env.apps.importers.pandapower.net_reading import quiet
from dcgrid_env.powerflow import distflow
from dcgrid_env.traces import write_profiles
from helpers.imports import apart_pu, assert_same_feeder, fates

pp = pytest.importorskip("pandapower", reason="pandapower is not installed (extra pandapower)")
pytestmark = pytest.mark.filterwarnings("ignore")  # pandas' and pandapower's own, as nets are made


def net_of_all_kinds():
    """A net with every kind of element that a balanced feeder can hold."""
    with quiet():
        net = pp.create_empty_network(sn_mva=5.0, f_hz=60.0)
        for kv in (110.0, 20.0, 20.0, 20.0, 0.4, 0.4, 20.0, 20.0):
            pp.create_bus(net, kv)
        pp.create_ext_grid(net, 0, vm_pu=1.03, va_degree=10.0)
        pp.create_transformer(net, 0, 1, "25 MVA 110/20 kV", tap_pos=-3)
        pp.create_transformer(net, 3, 4, "0.4 MVA 20/0.4 kV", tap_pos=1, parallel=2)
        pp.create_lines(net, [1, 2, 3, 2], [2, 3, 6, 1], 4.0, "NA2XS2Y 1x240 RM/25 12/20 kV")
        pp.create_line(net, 4, 5, 0.2, "NAYY 4x150 SE")
        pp.create_switch(net, 6, 2, et="l", closed=False)
        pp.create_switch(net, 2, 7, et="b", closed=True)
        pp.create_load(net, 3, 1.5, 0.4, scaling=0.8)
        pp.create_load(net, 5, 0.05, 0.02, const_z_p_percent=40, const_z_q_percent=40)
        pp.create_sgen(net, 7, 0.6, -0.1)
        pp.create_storage(net, 2, 0.1, 1.0, q_mvar=0.05)
        pp.create_shunt(net, 3, q_mvar=-0.3, p_mw=0.01, vn_kv=21.0, step=2)
        pp.create_ward(net, 2, 0.1, 0.05, 0.02, 0.03)
        pp.create_motor(net, 5, 0.02, 0.9, efficiency_percent=90.0)
        pp.create_asymmetric_load(net, 5, **dict.fromkeys(("p_a_mw", "p_b_mw", "p_c_mw"), 0.01), scaling=0.9)
        pp.create_asymmetric_sgen(net, 5, **dict.fromkeys(("q_a_mvar", "q_b_mvar", "q_c_mvar"), 0.002))
        pp.create_impedance(net, 3, 6, 0.05, 0.04, 5.0, in_service=False)
    return net


def test_voltages_of_a_net_of_all_kinds_are_pandapowers():
    imported = read_pandapower(net_of_all_kinds())
    assert apart_pu(imported) < 1e-7
    found = fates(imported)
    assert found["line", "taken"] == ("2", "3", "1", "0", "4") or set(found["line", "taken"]) == set("01234")
    assert found["bus", "nothing lost"] == ("6",)
    assert imported.bus_of["7"] == "2"
    for kind in ("load", "sgen", "storage", "shunt", "ward", "motor", "asymmetric_load", "asymmetric_sgen", "trafo"):
        assert (kind, "taken") in found


def net_of_all_kinds_with_a_loop():
    net = net_of_all_kinds()
    pp.create_line(net, 6, 1, 1.0, "NAYY 4x150 SE")
    return net


@pytest.mark.parametrize(
    ("net_of", "options", "loops"),
    [
        (net_of_all_kinds_with_a_loop, {}, 1),
        (pp.networks.case33bw, {}, 5),
        (pp.networks.create_cigre_network_mv, {"with_der": "all"}, 3),
        (pp.networks.mv_oberrhein, {}, 5),
    ],
)
@pytest.mark.slow
def test_closed_loops_are_solved_by_compensation(net_of, options, loops):
    with quiet():
        net = net_of(**options)
        net.switch["closed"], net.line["in_service"] = True, True
        net.ext_grid.loc[net.ext_grid.index[1:], "in_service"] = False  # Oberrhein has two
        imported = read_pandapower(net)
    assert Feeder.from_network(imported.network).n_loop == loops
    assert apart_pu(imported) < 1e-8
    texts = [row.text for row in imported.findings]
    assert sum("it closes a loop with" in text and "solved by compensation" in text for text in texts) == loops
    feeder = Feeder.from_network(imported.network)
    again = Feeder.from_network(read_pandapower(pandapower_net(feeder), bus_names=True).network)
    assert_same_feeder(feeder, again, rtol=1e-9)
    assert (again.loop_ends == feeder.loop_ends).all()


def test_the_users_net_is_left_alone():
    net = net_of_all_kinds()
    before = pp.to_json(net)
    read_pandapower(net)
    assert pp.to_json(net) == before
    assert logging.getLogger("pandapower").level <= logging.WARNING


@pytest.mark.parametrize(
    ("change", "told"),
    [
        (lambda n: pp.create_ext_grid(n, 5), "ext_grid 1: it feeds the same island"),
        (lambda n: pp.create_gen(n, 3, 0.1), "gen 0: it keeps a voltage"),
        (lambda n: pp.create_dcline(n, 1, 3, 0.1, 1.0, 0.0, 1.0, 1.0), "dcline 0: a DC line"),
        (lambda n: pp.create_xward(n, 3, 0, 0, 0, 0, 0.1, 0.1, 1.0), "xward 0: it keeps a voltage"),
        (lambda n: n.load.p_mw.__setitem__(1, np.nan), "table load, index 1: p_mw is 'nan'; give a finite number"),
        (lambda n: n.line.length_km.__setitem__(2, 0.0), "table line, index 2: length_km is '0.0'; give a num"),
        (lambda n: n.line.to_bus.__setitem__(0, 77), "table line, index 0: to_bus is '77'; give an index of the table"),
        (lambda n: n.trafo.vkr_percent.__setitem__(0, 50.0), "table trafo, index 0: vkr_percent is 50.0, more than"),
        (lambda n: n.line.drop(columns="r_ohm_per_km", inplace=True),
         "table line: the column r_ohm_per_km is missing"),
        (lambda n: n.ext_grid.in_service.__setitem__(0, False), "one reference bus|no source|reference"),
    ],
)  # fmt: skip
def test_what_cannot_be_is_refused_by_name(change, told):
    net = net_of_all_kinds()
    with quiet():
        change(net)
    with pytest.raises(FeederError) as refused:
        read_pandapower(net)
    assert any(one in str(refused.value) for one in told.split("|")), str(refused.value)


def test_a_share_of_constant_current_is_lost_by_name():
    net = net_of_all_kinds()
    net.load.loc[1, ["const_i_p_percent", "const_i_q_percent"]] = 30.0
    with pytest.raises(FeederError, match=r"load 1: its share of constant current .* --allow load accepts that"):
        read_pandapower(net)
    imported = read_pandapower(net, allow=["load"])
    assert 1e-7 < apart_pu(imported) < 1e-3


@pytest.mark.parametrize("kind", ["asymmetric_load", "asymmetric_sgen"])
@pytest.mark.parametrize("column", ["p_b_mw", "q_c_mvar"])
@pytest.mark.slow
def test_phases_that_differ_are_lost_by_name(kind, column):
    net = net_of_all_kinds()
    net[kind].loc[0, column] = 0.03
    with pytest.raises(FeederError, match=rf"{kind} 0: its phases differ.* --allow {kind} accepts that"):
        read_pandapower(net)
    found = fates(read_pandapower(net, allow=[kind]))
    assert found[kind, "lost"] == ("0",)
    assert (kind, "taken") not in found
    net[kind].loc[0, "in_service"] = False
    assert fates(read_pandapower(net))[kind, "nothing lost"] == ("0",)


@pytest.mark.slow
def test_taps_without_a_type_have_no_effect_and_are_named():
    net = net_of_all_kinds()
    lowest = {}
    for kind in ("Ratio", None):
        net.trafo.loc[0, "tap_changer_type"] = kind
        imported = read_pandapower(net)
        assert apart_pu(imported) < 1e-7
        lowest[kind] = min(imported.v_pu.values())
        named = fates(imported).get(("tap of trafo", "nothing lost"), ())
        assert named == (() if kind else ("0",))
    assert abs(lowest["Ratio"] - lowest[None]) > 0.01
    assert any("its tap_pos -3 has no effect, as in pandapower" in row.text for row in imported.findings)
    net.trafo.loc[0, "tap_pos"] = net.trafo.tap_neutral[0]
    assert ("tap of trafo", "nothing lost") not in fates(read_pandapower(net))


@pytest.mark.slow
def test_options_of_the_power_flow_in_a_net_are_lost_by_name(tmp_path):
    net = net_of_all_kinds()
    pp.set_user_pf_options(net, trafo_model="pi", max_iteration=7)
    pp.to_json(net, str(tmp_path / "net.json"))
    for source in (net, tmp_path / "net.json"):
        with pytest.raises(FeederError, match=r"user_pf_options trafo_model: .* --allow user_pf_options accepts that"):
            read_pandapower(source)
        assert apart_pu(read_pandapower(source, allow=["user_pf_options"])) < 1e-7


def test_generators_may_be_fixed_at_their_power():
    net = net_of_all_kinds()
    pp.create_gen(net, 3, 0.2, vm_pu=1.01)
    imported = read_pandapower(net, fix_generators=True)
    assert imported.v_pu["3"] == pytest.approx(1.01)
    assert apart_pu(imported) < 1e-7


@pytest.mark.parametrize("name", ["ieee33", "ieee123"])
@pytest.mark.slow
def test_a_feeder_comes_back_from_a_net(tmp_path, name):
    feeder = load_feeder(name)
    write_pandapower(feeder, tmp_path / "net.json")
    imported = read_pandapower(tmp_path / "net.json", bus_names=True)
    assert apart_pu(imported) < 1e-8
    if name == "ieee33":
        assert_same_feeder(feeder, Feeder.from_network(imported.network))
    else:  # closed switches, branches without impedance there, join their buses
        assert len(imported.bus_of) == feeder.n_bus
        assert len(set(imported.bus_of.values())) == feeder.n_bus - np.sum((feeder.r_ohm == 0) & (feeder.x_ohm == 0))


@pytest.mark.slow
def test_an_empty_text_is_an_empty_cell():
    with quiet():
        net = pp.networks.create_cigre_network_mv()
    feeder = Feeder.from_network(read_pandapower(net).network)
    assert net.trafo.tap_side.isna().all()
    net.trafo["tap_side"] = net.trafo["tap_changer_type"] = ""
    assert_same_feeder(feeder, Feeder.from_network(read_pandapower(net).network))


@pytest.mark.slow
def test_a_net_of_all_kinds_comes_back():
    feeder = Feeder.from_network(read_pandapower(net_of_all_kinds()).network)
    again = read_pandapower(pandapower_net(feeder))
    assert_same_feeder(feeder, Feeder.from_network(again.network))


@pytest.fixture
def file(tmp_path):
    path = tmp_path / "net.json"
    pp.to_json(net_of_all_kinds(), str(path))
    return path


@pytest.mark.slow
def test_a_file_gives_what_its_net_gives(file):
    feeders = [Feeder.from_network(read_pandapower(source).network) for source in (net_of_all_kinds(), file)]
    assert_same_feeder(*feeders)
    assert_same_feeder(feeders[0], Feeder.from_network(read_pandapower(file, trust=True).network))


@pytest.mark.slow
def test_nothing_that_a_file_names_is_imported_or_called(file, tmp_path, monkeypatch):
    """pandapower's own reader would import the module and make the object; a marker file would show it."""
    marker = tmp_path / "was_run"
    (tmp_path / "hostile_module.py").write_text(f"open({str(marker)!r}, 'w')\ndef it(*a, **k): pass\n")
    monkeypatch.syspath_prepend(tmp_path)
    net = json.loads(file.read_text())
    hostile = {"_module": "hostile_module", "_class": "function", "_object": "it"}
    net["_object"]["name"] = "n"
    net["_object"]["extra"] = hostile
    controllers = json.loads(net["_object"]["controller"]["_object"])
    row = {"object": hostile, "in_service": True}
    controllers["data"], controllers["index"] = [[row.get(c) for c in controllers["columns"]]], [0]
    net["_object"]["controller"]["_object"] = json.dumps(controllers)
    loads = json.loads(net["_object"]["load"]["_object"])
    loads["data"][0][loads["columns"].index("name")] = hostile
    net["_object"]["load"]["_object"] = json.dumps(loads)
    net["_object"]["sgen"]["_object"] = str(tmp_path / "net.json")  # a path, which pandapower's reader would open
    file.write_text(json.dumps(net))
    with pytest.raises(FeederError, match="table sgen"):
        read_pandapower(file)
    del net["_object"]["sgen"]
    file.write_text(json.dumps(net))
    with pytest.raises(FeederError, match=r"controller 0: it moves nothing.* --allow controller"):
        read_pandapower(file)
    read_pandapower(file, allow=["controller"])
    assert not marker.exists()


@pytest.mark.parametrize(
    ("source", "options", "told"),
    [
        ("case33", {}, "do you mean case33bw"),
        ("simple_four_bus_system", {"arguments": {"colour": 1}}, "has no argument 'colour'"),
        ("1-MV-nowhere--0-sw", {}, "no code of SimBench's|simbench is missing"),
        ("missing.json", {}, "missing.json cannot be read"),
        (7, {}, "int is no pandapower net"),
        ("runpp", {}, "'runpp' is no network"),
    ],
)
def test_a_source_that_there_is_not_is_said(source, options, told):
    with pytest.raises(FeederError) as refused:
        read_pandapower(source, **options)
    assert any(one in str(refused.value) for one in told.split("|")), str(refused.value)


NETS = [("case33bw", {}, None), ("create_cigre_network_mv", {}, None)]
SLOW = [
    ("create_kerber_landnetz_kabel_1", {}, None),
    ("create_cigre_network_mv", {"with_der": "pv_wind"}, None),
    ("create_cigre_network_mv", {"with_der": "all"}, None),
    ("create_cigre_network_lv", {}, None),
    ("mv_oberrhein", {}, "58"),
    ("mv_oberrhein", {}, "318"),
    ("create_kerber_dorfnetz", {}, None),
    ("create_kerber_landnetz_freileitung_1", {}, None),
    ("create_kerber_landnetz_freileitung_2", {}, None),
    ("create_kerber_landnetz_kabel_2", {}, None),
    ("create_kerber_vorstadtnetz_kabel_1", {}, None),
    ("create_kerber_vorstadtnetz_kabel_2", {}, None),
    ("1-LV-rural1--0-sw", {}, None),
    ("1-LV-urban6--0-sw", {}, None),
    ("1-MV-rural--0-sw", {}, None),
    ("1-MV-urban--0-sw", {}, None),
    ("1-MV-comm--0-no_sw", {}, None),
    ("1-MV-urban--0-no_sw", {}, None),
]


@pytest.mark.parametrize(
    ("source", "arguments", "at"), [*NETS, *(pytest.param(*one, marks=pytest.mark.slow) for one in SLOW)]
)
@pytest.mark.slow
def test_voltages_of_a_published_net_are_pandapowers(source, arguments, at):
    if "-" in source:
        pytest.importorskip("simbench", reason="simbench is not installed")
    imported = read_pandapower(source, arguments=arguments, at=at)
    assert apart_pu(imported) < 1e-7
    feeder = Feeder.from_network(imported.network)
    assert len(imported.v_pu) == feeder.n_bus
    assert_same_feeder(feeder, Feeder.from_network(read_pandapower(pandapower_net(feeder), bus_names=True).network))


def test_a_transformer_to_a_bus_out_of_service_is_left_out():
    net = net_of_all_kinds()
    with quiet():
        bus = pp.create_bus(net, 0.4, in_service=False)
        pp.create_transformer(net, 3, bus, "0.4 MVA 20/0.4 kV")
        load = pp.create_load(net, bus, 0.01)
    imported = read_pandapower(net)
    assert str(bus) not in Feeder.from_network(imported.network).bus_ids
    assert str(load) in fates(imported)["load", "nothing lost"]
    assert apart_pu(imported) < 1e-7


@pytest.mark.slow
def test_profiles_in_simbenchs_form_give_pandapowers_voltages_over_time(tmp_path):
    import pandas

    with quiet():
        net = net_of_all_kinds()
    net.load["profile"], net.sgen["profile"] = ["H0", "G1"], ["PV"]
    rng, n = np.random.default_rng(0), 8
    times = [f"01.01.2016 {k // 4:02d}:{15 * (k % 4):02d}" for k in range(n)]
    shares = {name: rng.uniform(0.1, 1.0, n) for name in ("H0_pload", "H0_qload", "G1_pload", "G1_qload")}
    net["profiles"] = {
        "load": pandas.DataFrame({"time": times, **shares}),
        "renewables": pandas.DataFrame({"time": times, "PV": rng.uniform(0.0, 1.0, n)}),
    }
    imported = read_pandapower(net)
    found = fates(imported)
    assert found["profile of load", "taken"] == ("0",)
    assert found["profile of sgen", "taken"] == ("0",)
    left_out = "its profile is left out: it has a share of constant impedance"
    assert [row.names for row in imported.findings if row.text == left_out] == [("1",)]
    pp.to_json(net, str(tmp_path / "net.json"))
    of_file = read_pandapower(tmp_path / "net.json").profiles
    assert imported.profiles is not None
    assert of_file is not None
    np.testing.assert_array_equal(of_file.values, imported.profiles.values)
    assert (of_file.names, of_file.first_day) == (imported.profiles.names, "2016-01-01")
    write_profiles(imported.profiles, tmp_path / "load_profiles.csv")
    feeder = Feeder.from_network(imported.network)
    profiles = {
        "file": tmp_path / "load_profiles.csv", "columns": "bus", "unit": "kw", "days": "all", "uncovered": "nominal",
    }  # fmt: skip
    s = scenario_on(feeder, "1 x 1 kW at 4", "none").replace(
        load_profiles=profiles, background={"load_sigma": 0.0}, dt_s=900.0, horizon=n - 1
    )
    drawn = forecast(s, 0)
    for k in range(1, n):
        net.load.loc[0, ["p_mw", "q_mvar"]] = 1.5 * shares["H0_pload"][k], 0.4 * shares["H0_qload"][k]
        net.sgen.loc[0, "p_mw"] = 0.6 * net.profiles["renewables"]["PV"][k]
        with quiet():
            pp.runpp(net, calculate_voltage_angles=True, tolerance_mva=1e-9, numba=False)
        solved = distflow(feeder, drawn.p_load_kw[k - 1], drawn.q_load_kvar[k - 1], s.source_voltage_pu)
        ours = dict(zip(feeder.bus_ids, solved.v_pu.tolist(), strict=True))
        theirs = net.res_bus.vm_pu
        assert max(abs(ours[ours_bus] - theirs[int(bus)]) for bus, ours_bus in imported.bus_of.items()) < 1e-7
    net.profiles["load"] = net.profiles["load"].drop(columns="H0_pload")
    with pytest.raises(FeederError, match=r"load 0 has the profile 'H0', but net\.profiles has no column 'H0_pload'"):
        read_pandapower(net)


@pytest.mark.parametrize("code", ["1-LV-rural1--0-sw", "1-MV-rural--1-sw"])
@pytest.mark.slow
def test_simbenchs_year_gives_pandapowers_voltages_before_between_and_after_summer_time(code, tmp_path):
    simbench = pytest.importorskip("simbench", reason="simbench is not installed")
    with quiet():
        net = simbench.get_simbench_net(code)
        pp.to_json(net, str(tmp_path / "net.json"))
    imported = read_pandapower(tmp_path / "net.json")
    profiles = imported.profiles
    assert profiles is not None
    assert (profiles.step_s, profiles.first_day, profiles.duration_h) == (900.0, "2016-01-01", 366 * 24)
    feeder = Feeder.from_network(imported.network)
    values = simbench.get_absolute_values(net, profiles_instead_of_study_cases=True)
    skipped, repeated = 8264, 29096  # rows of 27.03.2016 03:00 and of the second 30.10.2016 02:00
    for row in (0, skipped - 1, skipped, repeated - 1, repeated, 35135):
        for (kind, column), table in values.items():
            if len(table):
                net[kind][column] = table.iloc[row]
        with quiet():
            pp.runpp(net, calculate_voltage_angles=True, tolerance_mva=1e-9, numba=False)
        load_kw, load_kvar = feeder.p_load_kw.copy(), feeder.q_load_kvar.copy()
        for name, value in zip(profiles.names, profiles.values[row], strict=True):
            to = load_kvar if name.endswith(".q") else load_kw
            to[feeder.bus_ids.index(name.removesuffix(".q"))] = value
        ours = dict(zip(feeder.bus_ids, distflow(feeder, load_kw, load_kvar).v_pu.tolist(), strict=True))
        theirs = net.res_bus.vm_pu
        assert max(abs(ours[our_bus] - theirs[int(bus)]) for bus, our_bus in imported.bus_of.items()) < 1e-6


def two_buses():
    net = pp.create_empty_network()
    first, second = (pp.create_bus(net, 20.0) for _ in range(2))
    pp.create_ext_grid(net, first, vm_pu=1.02)
    pp.create_line_from_parameters(net, first, second, 2.0, 0.3, 0.3, 200.0, 0.3)
    return net


@pytest.mark.parametrize(
    ("add", "text"),
    [
        (lambda n: pp.create_xward(n, 1, 0.1, 0, 0, 0, 0.1, 0.1, 1.0), "xward 0: it keeps a voltage"),
        (lambda n: pp.create_svc(n, 1, 1.0, -1.0, 1.0, 90.0), "svc 0: a static var compensator"),
        (lambda n: pp.create_load_dc(n, pp.create_bus_dc(n, 20.0), 0.1), "load_dc 0: a DC load"),
    ],
)
def test_refused_elements_of_a_file_are_named(add, text, tmp_path):
    net = two_buses()
    add(net)
    path = tmp_path / "net.json"
    pp.to_json(net, str(path))
    with pytest.raises(FeederError, match=text):
        read_pandapower(str(path))


@pytest.mark.slow
def test_three_windings_whose_tap_has_no_type(tmp_path):
    """pandapower writes the missing type as a word, and then ignores the tap."""
    net = two_buses()
    medium, low = pp.create_bus(net, 10.0), pp.create_bus(net, 0.4)
    pp.create_transformer3w_from_parameters(
        net, 1, medium, low, 20, 10, 0.4, 5, 3, 2, 6, 5, 4, 0.3, 0.3, 0.3, 10, 0.1,
        tap_side="hv", tap_neutral=0, tap_pos=2, tap_min=-5, tap_max=5, tap_step_percent=2.0,
    )  # fmt: skip
    pp.create_load(net, medium, 0.3, 0.1)
    assert net.trafo3w.tap_changer_type.tolist() == ["nan"]
    path = tmp_path / "net.json"
    pp.to_json(net, str(path))
    with quiet():
        pp.runpp(net, calculate_voltage_angles=True)
    found = read_pandapower(str(path))
    feeder = Feeder.from_network(found.network)
    v_pu = dict(zip(feeder.bus_ids, distflow(feeder, feeder.p_load_kw, feeder.q_load_kvar).v_pu, strict=True))
    assert v_pu[found.bus_of["2"]] == pytest.approx(net.res_bus.vm_pu[medium], abs=1e-7)
    assert fates(found)["tap of trafo3w", "nothing lost"] == ("0",)

"""Elements of GridLAB-D models in the tables, and what is lost or refused."""

import sys

import pytest

from dcgrid_env import FeederError
from dcgrid_env.apps.importers.gridlabd import read_gridlabd
from dcgrid_env.apps.importers.gridlabd.glm_reading import read_model
from dcgrid_env.apps.importers.opendss import circuit_process
from helpers.gridlabd_text import CABLES, CAPACITORS, HEAD, REGULATOR, SPLIT_PHASE, TRANSFORMERS

pytest.importorskip("opendssdirect", reason="OpenDSSDirect.py is not installed (extra opendss)")
LDC = REGULATOR.replace(
    "MORE",
    "Control LINE_DROP_COMP; Type A; band_center 122; band_width 2; time_delay 45; power_transducer_ratio 60; "
    "current_transducer_ratio 100; compensator_r_setting_A 2; compensator_x_setting_A 4;",
)
OUTPUT = REGULATOR.replace("MORE", "Control OUTPUT_VOLTAGE; Type A; band_center 7320 V; band_width 120;")


def rows(table):
    """Rows of a table by name."""
    columns = [name for name in table.__dataclass_fields__ if getattr(table, name)]
    return {name: {c: getattr(table, c)[k] for c in columns} for k, name in enumerate(table.name)}


@pytest.mark.slow
def test_regulators_keep_their_taps_and_settings(model):
    found = rows(read_gridlabd(model(LDC)).network.regulator)
    one = found["r1_a"]
    assert [found[f"r1_{phase}"]["tap"] for phase in "abc"] == [5, -3, 16]
    assert (one["tap_step"], one["tap_min"], one["tap_max"], one["kv_ln"]) == (0.00625, -16, 16, 7.2)
    assert (one["vreg_v"], one["band_v"], one["pt_ratio"], one["ct_primary_a"]) == (122.0, 2.0, 60.0, 100.0)
    assert (one["r_ldc_v"], one["x_ldc_v"], one["delay_s"], one["max_taps_per_move"]) == (2.0, 4.0, 45.0, 1)


@pytest.mark.slow
def test_taps_that_are_set_by_hand_are_fixed(model):
    found = rows(read_gridlabd(model(LDC.replace("LINE_DROP_COMP", "MANUAL"))).network.regulator)
    assert [found[f"r1_{phase}"]["tap"] for phase in "abc"] == [5, -3, 16]
    assert {row["max_taps_per_move"] for row in found.values()} == {0}


@pytest.mark.slow
def test_a_band_in_volts_of_the_line_is_referred_to_a_potential_transformer(model):
    one = rows(read_gridlabd(model(OUTPUT)).network.regulator)["r1_a"]
    assert (one["vreg_v"], one["band_v"], one["pt_ratio"]) == (122.0, 2.0, 60.0)


@pytest.mark.slow
def test_a_bank_is_one_regulator(model):
    text = LDC.replace("tap_pos_B -3; tap_pos_C 16", "control_level BANK; PT_phase B; tap_pos_B 5; tap_pos_C 5")
    found = rows(read_gridlabd(model(text)).network.regulator)
    assert {(row["phases"], row["sensed_phase"], row["tap"]) for row in found.values()} == {("abc", "b", 5)}


@pytest.mark.slow
def test_a_regulator_of_type_b_must_be_allowed(model):
    path = model(LDC.replace("Type A", "Type B"))
    with pytest.raises(FeederError, match=r"regulator r1: of type B.*--allow regulator accepts that"):
        read_gridlabd(path)
    assert len(read_gridlabd(path, allow=["regulator"]).network.regulator.name) == 3


@pytest.mark.slow
def test_ratings_of_conductors_and_transformers(model):
    network = read_gridlabd(model(CABLES)).network
    assert rows(network.phase_line)["u1"]["rating_a"] == pytest.approx(260.0)
    transformers = rows(read_gridlabd(model(TRANSFORMERS)).network.transformer)
    assert transformers["t1"]["kva"] == pytest.approx(900.0)  # which its rating equals


@pytest.mark.slow
def test_open_switches_and_capacitors(model):
    text = CAPACITORS + (
        "object node { name n3; phases ABCN; nominal_voltage 7200; }\n"
        "object switch { name s2; phases ABCN; from n2; to n3; status OPEN; }\n"
        "object switch { name s3; phases ABCN; from n1; to n3; status CLOSED; }\n"
    )
    network = read_gridlabd(model(text)).network
    assert {name: row["state"] for name, row in rows(network.switch).items()} == {
        "s1": "closed", "s2": "open", "s3": "closed",
    }  # fmt: skip
    capacitors = rows(network.capacitor)
    assert {name: row["state"] for name, row in capacitors.items()} == {
        "cw_a": "on", "cw_b": "on", "cw_c": "off", "cd_a": "on", "cd_b": "on",
    }  # fmt: skip
    assert capacitors["cd_a"]["connection"] == "delta"


@pytest.mark.slow
def test_the_source_and_bases(model):
    network = read_gridlabd(model(SPLIT_PHASE)).network
    source, node = network.source, network.node
    assert source.v_pu == pytest.approx((1.02,), abs=1e-6)
    assert source.bus == ("src",)
    assert {kv for bus, kv in zip(node.bus, node.base_kv_ln, strict=True) if bus == "tm"} == {0.12}
    assert network.source_of_facts == "GridLAB-D model model.glm"
    assert network.frequency_hz == 60.0


@pytest.mark.slow
def test_loads_that_are_alike_in_all_phases_are_one_row(model):
    text = (
        "object load { name wye; parent n1; phases ABCN; constant_power_A 9000; constant_power_B 9000; "
        "constant_power_C 9000; constant_impedance_A 500; }"
        "object load { name delta; parent n1; phases ABCD; constant_power_A 9000; constant_power_B 9000; "
        "constant_power_C 9000; }"
    )
    loads = rows(read_gridlabd(model(text)).network.phase_load)
    assert loads["wye"]["p_kw"] == pytest.approx((9.0, 9.0, 9.0))
    assert loads["delta"]["connection"] == "delta"
    assert loads["wye_a_impedance"]["model"] == "Z"


LOSSES = """
object triplex_meter { name m; parent n1; phases AS; }
object house { name h; parent n1; object ZIPload { base_power 1; }; }
object recorder { parent n1; property voltage_A; file x.csv; }
object fuse { name f; phases ABCN; from n1; to n2; status CLOSED; }
object node { name n2; phases ABCN; nominal_voltage 7200; }
object capacitor { name c; parent n2; phases ABCN; capacitor_A 9 kVAr; control VOLT; switchA CLOSED; }
schedule half { * * * * * 0.5; }
object load { name l; parent n2; phases AN; constant_power_A half*20000; }
""".replace("object triplex_meter { name m; parent n1; phases AS; }\n", "")


@pytest.mark.slow
def test_what_is_lost_must_be_allowed(model):
    path = model(LOSSES)
    with pytest.raises(FeederError, match="--allow house,zipload,fuse,schedule,capcontrol accepts that") as lost:
        read_gridlabd(path)
    for word in ("house h", "zipload", "fuse f: it never blows", "capcontrol c", "schedule l"):
        assert word in str(lost.value)
    allow = ["house", "zipload", "fuse", "capcontrol", "schedule"]
    findings = read_gridlabd(path, allow=allow).findings
    assert {row.kind for row in findings if row.fate == "lost"} == set(allow)
    assert any(row.kind == "recorder" and row.fate == "nothing lost" for row in findings)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("object series_reactor { name r; from src; to n1; }", "series_reactor r: a link of this class cannot be"),
        ("object switch { name s; phases ABCN; from n1; to nowhere; }", "switch s: to 'nowhere' is no object"),
        ("object switch { name s; phases ABCN; from n1; to lc; }", "to 'lc' is a line_configuration; must be one of"),
        ("object switch { name s; phases ABCN; from n1; to base; }", "to 'base' is the bus that it comes from"),
        ("object switch { name s; phases Q; from n1; to src; }", "phases 'Q' must be letters among"),
        ("object switch { name s; phases A; from n1; to src; status AJAR; }",
         "status 'AJAR' must be one of OPEN .0., CLOSED .1."),
        ("object load { name l; parent n1; phases AN; constant_power_A 5 ft; }", "constant_power_A '5 ft' must be in"),
        ("object load { name l; parent n1; phases AN; shunt_A 1; }", "load l: shunt_A '1' cannot be read here"),
        ("object load { name l; parent l; phases AN; }", "load l: parent 'l' makes a circle"),
        ("object node { name n1; phases A; nominal_voltage 1; }", "has an object of this name; rename one"),
        ("object node { name x; phases A; bustype SWING; nominal_voltage 1; }", "the buses src, x as sources"),
        ("object node { name x; phases A; }", "node x: nominal_voltage is missing; add it"),
        ("object capacitor { name c; phases A; }", "capacitor c: parent is missing"),
        ("object load { name l; parent n1; phases AN; base_power_A 9; power_pf_A 1.5; }",
         "power_pf_A '1.5' must be from"),
        ("object node { name x; phases ABC; bustype 1; nominal_voltage 7200; }", "bustype '1' keeps a voltage"),
        ("object node { name x; phases ABC; bustype 3; nominal_voltage 7200; }", "the buses src, x as sources"),
        ("object node { name x; phases 512; nominal_voltage 7200; }", "phases '512' must be letters among A, B, C"),
        ("object switch { name s; phases AS; from n1; to src; }", "phases 'AS' has S, which no switch"),
        (TRANSFORMERS.replace("connect_type WYE_WYE", "connect_type OPEN_WYE"),
         "connect_type 'OPEN_WYE' must be one of WYE_WYE"),
        (TRANSFORMERS.replace("primary_voltage 12470", "primary_voltage 0"), "primary_voltage '0' must be positive"),
        (TRANSFORMERS.replace("reactance 0.05", "reactance 0"), "needs a positive reactance"),
        (TRANSFORMERS.replace("to low2;", "to low2; status OPEN;"), "t2: status 'OPEN' cannot be represented"),
        (REGULATOR.replace("MORE", "Control SOMEHOW;"),
         "must be one of MANUAL .1., OUTPUT_VOLTAGE .2., REMOTE_NODE .3., LINE_DROP_COMP .4."),
        (LDC.replace("connect_type WYE_WYE", "connect_type CLOSED_DELTA"), "connect_type 'CLOSED_DELTA' cannot be"),
    ],
)  # fmt: skip
def test_errors_name_file_line_object_property_and_value(text, said, model):
    with pytest.raises(FeederError, match=said) as refused:
        read_model(model(text))
    assert "\n" not in str(refused.value)
    assert "model" in str(refused.value)


def test_unknown_losses_and_missing_files(model, tmp_path):
    with pytest.raises(FeederError, match="'nonsense' is no kind of loss; choose among"):
        read_model(model(), allow=["nonsense"])
    with pytest.raises(FeederError, match="there is no file"):
        read_model(tmp_path / "none.glm")
    with pytest.raises(FeederError, match="no source"):
        read_model(model("object node { name n; phases A; nominal_voltage 1; }", head=""))
    unbalanced = HEAD.replace("voltage_A 7344", "voltage_A 7000")
    with pytest.raises(FeederError, match=r"source src: its voltages are not balanced.*--allow source"):
        read_model(model(head=unbalanced))


@pytest.mark.slow
def test_the_child_process_reads_what_this_process_reads(model, monkeypatch):
    path = model(LDC)
    assert repr(read_gridlabd(path)) == repr(read_model(path))
    monkeypatch.setattr(circuit_process, "LONGEST_S", 0.1)
    with pytest.raises(FeederError, match=r"model\.glm: reading it took more than 0\.1 s; import a part") as refused:
        read_gridlabd(path)
    assert "--trust" not in str(refused.value)


@pytest.mark.skipif(sys.platform != "linux", reason="the operating system does not limit the address space")
@pytest.mark.slow
def test_memory_is_limited(model, monkeypatch):
    monkeypatch.setattr(circuit_process, "LARGEST_MEMORY_BYTES", 2**28)
    path = model("object node { name n; " + "a_long_name a_long_value; " * 1_000_000 + "}")
    with pytest.raises(FeederError, match=r"model\.glm: reading it takes more memory than 0\.25 GiB; import a part of"):
        read_gridlabd(path)

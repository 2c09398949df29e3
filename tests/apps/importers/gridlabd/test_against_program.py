"""Imported models against GridLAB-D as it runs: keywords and their numbers, defaults and voltages."""

import pytest

from dcgrid_env import FeederError
from dcgrid_env.apps.importers.gridlabd.glm_reading import read_model
from dcgrid_env.apps.importers.gridlabd.glm_words import ENUMERATIONS, PHASES, phase_letters
from helpers.gridlabd_program import properties, voltages
from helpers.gridlabd_text import HEAD

pytest.importorskip("opendssdirect", reason="OpenDSSDirect.py is not installed (extra opendss)")
CLOSE_PU = 1e-6
CONCRETE = {"link": "switch"}
"""A class to make an object of, where the one that defines a property cannot be."""
NUMBERS = [(kind, name) for kind, names in ENUMERATIONS.items() for name in names]


@pytest.mark.parametrize(("kind", "name"), NUMBERS)
@pytest.mark.slow
def test_numbers_of_keywords_are_gridlabds(kind, name, tmp_path):
    words, made = ENUMERATIONS[kind][name], CONCRETE.get(kind, kind)
    path = tmp_path / "m.glm"
    objects = [f"object {made} {{ name x{number}; {name} {number}; }}\n" for number in words.values()]
    path.write_text("module powerflow;\n" + "".join(objects))
    read = properties(path, [(f"x{number}", name) for number in words.values()])
    assert list(read.values()) == list(words)


@pytest.mark.slow
def test_numbers_of_phases_are_gridlabds(tmp_path):
    path = tmp_path / "m.glm"
    sums = [*PHASES.values(), 0x7, 0xF, 0x107, 0x72]
    path.write_text("module powerflow;\n" + "".join(f"object node {{ name x{k}; phases {k}; }}\n" for k in sums))
    read = properties(path, [(f"x{k}", "phases") for k in sums])
    for number, theirs in zip(sums, read.values(), strict=True):
        assert set(phase_letters(str(number))) == set(theirs.replace("|", ""))
        assert phase_letters(hex(number)) == phase_letters(str(number))


def beside(kind, properties):
    """Return a link in parallel with a line, which supplies its second bus when the link is open."""
    return (
        "object node { name n2; phases ABCN; nominal_voltage 7200; }\n"
        f"object {kind} {{ name s; phases ABCN; from n1; to n2; {properties} }}\n"
        "object overhead_line { name l2; phases ABCN; from src; to n2; length 3 mile; configuration lc; }\n"
        "object load { name w; parent n2; phases ABCN; nominal_voltage 7200; constant_power_A 400 kW;"
        " constant_power_B 250000+80000j; constant_power_C 200+90j kVA; }\n"
    )


def load(properties, phases="ABCN"):
    return f"object load {{ name z; parent n1; phases {phases}; nominal_voltage 7200; {properties} }}\n"


def capacitor(properties):
    return (
        "object capacitor { name c; parent n1; phases ABCN; capacitor_A 300000; capacitor_B 200000;"
        f" capacitor_C 100000; nominal_voltage 7200; {properties} }}\n"
    )


DISTANCES = "distance_AB 2.5; distance_BC 4.5; distance_AC 7.0; distance_AN 5.66; distance_BN 4.27; distance_CN 5.0;"


def overhead(distances):
    return (
        "object overhead_line_conductor { name oh; geometric_mean_radius 0.0244; resistance 0.306; diameter 0.721; }\n"
        f"object line_spacing {{ name sp; {distances} distance_AE 28; distance_BE 28; distance_CE 28;"
        " distance_NE 24; }\n"
        "object line_configuration { name oc; conductor_A oh; conductor_B oh; conductor_C oh; conductor_N oh;"
        " spacing sp; }\n"
        "object overhead_line { name o; phases ABCN; from n1; to m; length 30000; configuration oc; }\n"
        "object load { name m; phases ABCN; nominal_voltage 7200; constant_power_A 3e5+9e4j; constant_power_B 2e5; }\n"
    )


CN = (
    "outer_diameter 1.29; conductor_gmr 0.0171; conductor_diameter 0.567; conductor_resistance 0.41;"
    " neutral_gmr 0.00208; neutral_resistance 14.87; neutral_diameter 0.0641; neutral_strands 13;"
)
TS = (
    "outer_diameter 1.06; conductor_gmr 0.0111; conductor_diameter 0.368; conductor_resistance 0.97; shield_gmr 0.0365;"
    " shield_resistance 6.2; shield_thickness 0.005; shield_diameter 0.88;"
)


def cable(distances, conductor):
    return (
        f"object underground_line_conductor {{ name ug; {conductor} insulation_relative_permitivitty 2.3; }}\n"
        f"object line_spacing {{ name sp; {distances} }}\n"
        "object line_configuration { name uc; conductor_A ug; conductor_B ug; conductor_C ug; spacing sp; }\n"
        "object underground_line { name u; phases ABC; from n1; to m; length 30000; configuration uc; }\n"
        "object load { name m; phases ABCN; nominal_voltage 7200; constant_power_A 3e5+9e4j; constant_power_B 2e5; }\n"
    )


def centre_tapped(properties):
    return (
        f"object transformer_configuration {{ name ct; connect_type 5; {properties} primary_voltage 7200;"
        " secondary_voltage 120; }\n"
        "object transformer { name t1; phases BS; from n1; to tn; configuration ct; }\n"
        "object triplex_node { name tn; phases BS; nominal_voltage 120; power_1 6000; power_12 4000+900j; }\n"
    )


def regulator(properties):
    return (
        f"object regulator_configuration {{ name rc; raise_taps 16; lower_taps 16; {properties} }}\n"
        "object regulator { name r1; phases ABC; from n1; to n2; configuration rc; }\n"
        "object load { name n2; phases ABCN; nominal_voltage 7200; constant_power_A 300 kW; constant_power_B 2e5; }\n"
    )


MODELS = {
    "bank, all phases open": beside("switch", "phase_A_state OPEN; phase_B_state OPEN; phase_C_state OPEN;"),
    "bank, most phases open": beside("switch", "phase_A_state 0; phase_C_state OPEN; operating_mode 1;"),
    "bank, one phase open": beside("switch", "phase_B_state OPEN;"),
    "bank, half open": beside("switch", "phase_A_state OPEN;").replace("ABCN; from n1", "ABN; from n1"),
    "bank, half open, status open": beside("switch", "phase_A_state OPEN; status 0;").replace(
        "ABCN; from n1", "ABN; from n1"
    ),
    "individual": beside("switch", "operating_mode 0; phase_A_state 0;"),
    "status open, phases closed": beside("switch", "status OPEN; phase_A_state CLOSED; phase_B_state CLOSED;"),
    "recloser": beside("recloser", "phase_A_state OPEN; phase_B_state OPEN;"),
    "sectionalizer": beside("sectionalizer", "operating_mode INDIVIDUAL; phase_B_state OPEN;"),
    "fuse, blown": beside("fuse", "phase_A_status BLOWN; phase_B_status 0;"),
    "switch impedance": beside("switch", "switch_impedance 0.5+1j;"),
    "switch reactance": beside("switch", "switch_reactance 1.5; switch_resistance 0;"),
    "no fractions": load("base_power_A 500000; power_pf_A 0.9; base_power_B 300 kVA; power_fraction_B 0.5;"),
    "rest of fractions": load("base_power_A 5e5; current_fraction_A 0.3; current_pf_A -0.8; impedance_fraction_A 0.1;"),
    "too large fractions": load("base_power_A 500000; power_fraction_A 0.6; current_fraction_A 0.6;"),
    "power factors of 0": load("base_power_A 5e5; power_pf_A 0; impedance_fraction_A 0.5; impedance_pf_A 0;"),
    "fractions replace constants": load("base_power_A 500000; constant_power_A 300000; constant_current_A 9;"),
    "fractions leave a node's power": load("base_power_A 500000; power_A 300000;"),
    "fractions in delta": load("base_power_B 2e5; power_pf_B 0.8; impedance_fraction_B 0.25;", "ABCD"),
    "fractions without nominal voltage": load("base_power_A 500000; impedance_fraction_A 1;").replace(
        "nominal_voltage 7200; ", ""
    ),
    "phases as a number": load("constant_power_A 300000; constant_power_B 2e5;", "263"),
    "source as a number": "",
    "distance of 0": overhead(DISTANCES.replace("AB 2.5", "AB 0").replace("AN 5.66", "AN 0.0")),
    "distances missing": overhead("distance_AB 2.5; distance_BC 4.5;"),
    "distances of a cable": cable(DISTANCES, CN),
    "distances of 0 of a cable": cable("distance_AB 0.0 in; distance_BC 0.0 in;", CN),
    "tape shield": cable(DISTANCES, TS),
    "distances of 0 of a tape shield": cable("distance_AB 1; distance_BC 0;", TS),
    "centre-tapped, power_rating alone": centre_tapped("power_rating 75; impedance 0.006+0.0136j;"),
    "centre-tapped, impedance1 alone": centre_tapped(
        "powerB_rating 50; impedance 0.006+0.014j; impedance1 0.01+0.01j;"
    ),
    "bank of a capacitor, closed": capacitor("control_level BANK; pt_phase B; switchB CLOSED;"),
    "bank of a capacitor, open": capacitor("control_level 0; pt_phase 1; switchB CLOSED; switchC 1;"),
    "capacitor of two phases": capacitor("phases_connected 3; switchA 1; switchB 1; switchC CLOSED;"),
    "capacitor out of service": capacitor("service_status OUT_OF_SERVICE; switchA 1; switchB 1;"),
    "regulator in numbers": regulator("connect_type 1; Control 1; Type 1; regulation 0.1; tap_pos_A 5; tap_pos_B -3;"),
    "regulator with resistance": regulator("connect_type 1; regulation 0.1; tap_pos_A 16; tap_pos_B -8;").replace(
        "configuration rc;", "configuration rc; regulator_resistance 5;"
    ),
    "regulator without regulation": regulator("connect_type 1; tap_pos_A 5;"),
}


@pytest.mark.parametrize("name", MODELS)
@pytest.mark.slow
def test_voltages_are_gridlabds(name, model):
    head = HEAD.replace("bustype SWING", "bustype 2") if name == "source as a number" else HEAD
    path = model(MODELS[name], head)
    theirs = voltages(path)
    imported = read_model(path, allow=["fuse"] if "fuse" in name else ["recloser"] if name == "recloser" else
                          ["sectionalizer"] if name == "sectionalizer" else [])  # fmt: skip
    node = imported.network.node
    base = {
        f"{bus}.{'abc'[phase - 1]}": 1e3 * kv
        for bus, phase, kv in zip(node.bus, node.phase, node.base_kv_ln, strict=True)
    }
    compared = {name: abs(v - theirs[name] / base[name]) for name, v in imported.v_pu.items()}
    assert len(compared) >= 6
    assert max(compared.values()) < CLOSE_PU, max(compared, key=lambda one: compared[one])


@pytest.mark.parametrize(
    ("number", "word", "more"),
    [
        (2, "OUTPUT_VOLTAGE", ""),
        (3, "REMOTE_NODE", "sense_node n2;"),
        (4, "LINE_DROP_COMP", "compensator_r_setting_A 3; compensator_x_setting_A 5;"),
    ],
)
@pytest.mark.slow
def test_controls_by_number_are_those_by_keyword(number, word, more, model):
    settings = (
        "connect_type 1; Type A; regulation 0.1; band_center 122; band_width 2; power_transducer_ratio 60;"
        " current_transducer_ratio 500; time_delay 45; tap_pos_A 4; Control CONTROL;"
    )
    where = "to n2; " + more if "sense" in more else "to n2; "
    text = regulator(settings + ("" if "sense" in more else more)).replace("to n2; ", where)
    allow = ["regulator"] if word == "REMOTE_NODE" else []
    found = [
        read_model(model(text.replace("CONTROL", str(one))), allow=allow).network.regulator for one in (number, word)
    ]
    assert repr(found[0]) == repr(found[1])
    assert found[0].r_ldc_v[0] == (3.0 if word == "LINE_DROP_COMP" else 0.0)
    assert found[0].x_ldc_v[0] == (5.0 if word == "LINE_DROP_COMP" else 0.0)


AUTOMATIC = "connect_type 1; regulation 0.1; band_center 7320; band_width 120; Control 2; Type A;"
DEFAULTS = {
    "switch": (beside("switch", "EXTRA"), "s", "status operating_mode phase_A_state phase_B_state phase_C_state"),
    "fuse": (beside("fuse", "EXTRA"), "s", "status phase_A_status phase_B_status phase_C_status"),
    "line": (beside("switch", "").replace("length 3 mile;", "length 3 mile; EXTRA"), "l2", "status"),
    "node": (beside("switch", "").replace("name n2;", "name n2; EXTRA"), "n2", "bustype"),
    "load": (
        load("base_power_A 5e5; impedance_fraction_A 0.3; EXTRA"),
        "z", "current_fraction_A power_pf_A current_pf_A impedance_pf_A",
    ),
    "capacitor": (capacitor("EXTRA"), "c", "switchA switchB switchC control control_level service_status"),
    "manual regulator": (
        regulator("connect_type 1; EXTRA"),
        "rc", "regulation Control Type control_level time_delay dwell_time band_center band_width",
    ),
    "automatic regulator": (
        regulator(f"{AUTOMATIC} EXTRA"),
        "rc", "time_delay dwell_time compensator_r_setting_A compensator_x_setting_A current_transducer_ratio PT_phase",
    ),
    "spacing": (overhead("distance_AB 2.5; EXTRA"), "sp", "distance_AC distance_BC distance_AN distance_BN"),
    "centre-tapped transformer": (
        centre_tapped("powerB_rating 50; impedance 0.006+0.0136j; EXTRA"),
        "ct", "shunt_resistance shunt_reactance resistance1 reactance1 no_load_loss full_load_loss",
    ),
    "centre-tapped transformer by its losses": (
        centre_tapped("powerB_rating 50; no_load_loss 0.01; full_load_loss 0.02; EXTRA"),
        "ct", "reactance_resistance_ratio",
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", DEFAULTS)
@pytest.mark.slow
def test_defaults_are_gridlabds(name, model):
    """What is left out means the same as the value that GridLAB-D gives it."""
    text, item, names = DEFAULTS[name]
    allow = ["fuse"] if name == "fuse" else []
    path = model(text.replace("EXTRA", ""))
    found = properties(path, [(item, one) for one in names.split()])
    without = read_model(path, allow=allow)
    written = " ".join(f"{one} {value};" for (_, one), value in found.items())
    explicit = read_model(model(text.replace("EXTRA", written)), allow=allow)
    assert repr(explicit.network) == repr(without.network)


def test_a_compensator_needs_a_current_transducer(model):
    text = regulator(f"{AUTOMATIC} power_transducer_ratio 60; compensator_x_setting_B 4;").replace(
        "Control 2", "Control 4"
    )
    with pytest.raises(FeederError, match="regulator_configuration rc: current_transducer_ratio must be positive"):
        read_model(model(text))


@pytest.mark.slow
def test_a_regulation_in_percent_is_refused(model):
    """GridLAB-D has no unit for it, and reads the number as it is."""
    text = regulator("connect_type 1; regulation 10 %; tap_pos_A 5;")
    path = model(text)
    assert properties(path, [("rc", "regulation")]) == {("rc", "regulation"): 10.0}
    with pytest.raises(FeederError, match="regulator_configuration rc: regulation '10 %' must be in pu"):
        read_model(path)

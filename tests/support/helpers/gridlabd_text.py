"""Small GridLAB-D models, and the voltages that GridLAB-D 6.0.0 finds for them."""

HEAD = """
clock { timezone EST+5EDT; starttime '2001-01-01 0:00:00'; stoptime '2001-01-01 0:00:01'; }
module powerflow { solver_method NR; line_capacitance true; }
object node { name src; phases ABCN; bustype SWING; nominal_voltage 7200;
    voltage_A 7344; voltage_B -3672-6360.0906j; voltage_C -3672+6360.0906j; }
object line_configuration { name lc; z11 0.5+1.1j; z12 0.15+0.5j; z13 0.15+0.4j; z21 0.15+0.5j; z22 0.48+1.12j;
    z23 0.16+0.42j; z31 0.15+0.4j; z32 0.16+0.42j; z33 0.49+1.08j; c11 14; c22 13; c33 15; c12 -3; c21 -3; c13 -2;
    c31 -2; c23 -2.5; c32 -2.5; }
object overhead_line { name l1; phases ABCN; from src; to n1; length 2 mile; configuration lc; }
object node { name n1; phases ABCN; nominal_voltage 7200; }
object load { name base; parent n1; phases ABCN; nominal_voltage 7200; constant_power_A 300 kW;
    constant_power_B 250000+80000j; constant_power_C 200+90j kVA; }
"""
CABLES = """
object underground_line_conductor { name cn; outer_diameter 1.29; conductor_gmr 0.0171; conductor_diameter 0.567;
    conductor_resistance 0.41; neutral_gmr 0.00208; neutral_resistance 14.87; neutral_diameter 0.0641;
    neutral_strands 13; insulation_relative_permitivitty 2.3; rating.summer.continuous 260; }
object underground_line_conductor { name ts; outer_diameter 1.06; conductor_gmr 0.0111; conductor_diameter 0.368;
    conductor_resistance 0.97; shield_gmr 0.0365; shield_resistance 6.2; shield_thickness 0.005; shield_diameter 0.88;
    insulation_relative_permitivitty 2.3; }
object underground_line_conductor { name bare; outer_diameter 1.06; conductor_gmr 0.0111; conductor_diameter 0.368;
    conductor_resistance 0.97; }
object line_spacing { name sp; distance_AB 0.5; distance_BC 0.5; distance_AC 1.0; distance_AN 0.3; distance_BN 0.4;
    distance_CN 0.5; distance_AE 28; distance_BE 28; distance_CE 28; distance_NE 24; }
object line_configuration { name ucn; conductor_A cn; conductor_B cn; conductor_C cn; spacing sp; }
object line_configuration { name ucnn; conductor_A cn; conductor_B cn; conductor_C cn; conductor_N bare; spacing sp; }
object line_configuration { name uts; conductor_A ts; conductor_B ts; conductor_C ts; conductor_N bare; spacing sp; }
object line_configuration { name uts1; conductor_C ts; conductor_N bare; spacing sp; }
object overhead_line_conductor { name oh; geometric_mean_radius 0.0244; resistance 0.306; diameter 0.721; }
object line_configuration { name ohc; conductor_A oh; conductor_B oh; conductor_C oh; conductor_N oh; spacing sp; }
object underground_line { name u1; phases ABC; from n1; to m1; length 3000; configuration ucn; }
object underground_line { name u2; phases ABCN; from n1; to m2; length 3000; configuration ucnn; }
object underground_line { name u3; phases ABCN; from n1; to m3; length 3000; configuration uts; }
object underground_line { name u4; phases CN; from n1; to m4; length 3000; configuration uts1; }
object overhead_line { name o6; phases ABCN; from n1; to m6; length 3000; configuration ohc; }
object load { name m4; phases CN; nominal_voltage 7200; constant_power_C 100+90j kVA; }
""" + "".join(
    f"object load {{ name m{k}; phases ABCN; nominal_voltage 7200; constant_power_A 300 kW; "
    "constant_power_B 250000+80000j; constant_power_C 100+90j kVA; }\n"
    for k in (1, 2, 3, 6)
)
SPLIT_PHASE = """
object transformer_configuration { name ct; connect_type SINGLE_PHASE_CENTER_TAPPED; power_rating 50; powerB_rating 50;
    primary_voltage 7200; secondary_voltage 120; impedance 0.006+0.0136j; }
object transformer { name t1; phases BS; from n1; to tn; configuration ct; }
object triplex_node { name tn; phases BS; nominal_voltage 120; }
object triplex_line_conductor { name "4/0 AA"; resistance 0.48; geometric_mean_radius 0.0158; }
object triplex_line_configuration { name tc; conductor_1 4/0 AA; conductor_2 4/0 AA; conductor_N 4/0 AA;
    insulation_thickness 0.08; diameter 0.522; }
object triplex_line { name tl; phases BS; from tn; to tm; length 150; configuration tc; }
object triplex_meter { name tm; phases BS; nominal_voltage 120;
    object triplex_load { name hl; phases BS; nominal_voltage 120; constant_power_1 6000+2000j; constant_power_2 3 kW;
        constant_power_12 8000+1500j; constant_current_1 10-3j; constant_current_12 8-2j; constant_impedance_2 12+2j; };
}
object triplex_load { name frac; parent tm; phases BS; nominal_voltage 120; base_power_12 5 kVA; power_fraction_12 0.3;
    power_pf_12 0.95; current_fraction_12 0.3; current_pf_12 -0.97; impedance_fraction_12 0.4; impedance_pf_12 0.9; }
object triplex_node { name old; parent tm; phases BS; nominal_voltage 120; power_1 1000+100j; power_12 2000;
    current_2 4-1j; }
"""
TRANSFORMERS = """
object transformer_configuration { name yy; connect_type WYE_WYE; power_rating 900 kVA; primary_voltage 7200;
    secondary_voltage 277; resistance 0.01; reactance 0.06; }
object transformer { name t1; phases ABCN; from n1; to low; configuration yy; }
object load { name low; phases ABCN; nominal_voltage 277; constant_power_A 200000+100000j;
    constant_power_B 150000+60000j; constant_power_CA 50000+10000j; constant_power_BN 1000; }
object transformer_configuration { name sp; connect_type SINGLE_PHASE; powerC_rating 100; power_rating 100;
    primary_voltage 7200; secondary_voltage 240; resistance 0.01; reactance 0.03; }
object transformer { name t2; phases CN; from n1; to low2; configuration sp; }
object load { name low2; phases CN; nominal_voltage 240; constant_power_C 70000+20000j; }
object transformer_configuration { name yy2; connect_type WYE_WYE; power_rating 200 kVA; primary_voltage 12470;
    secondary_voltage 480; resistance 0.01; reactance 0.05; }
object transformer { name t3; phases ABN; from n1; to low3; configuration yy2; }
object load { name low3; phases ABN; nominal_voltage 277; constant_power_A 70000+20000j; constant_power_B 30000; }
"""
CAPACITORS = """
object node { name n2; phases ABCN; nominal_voltage 7200; }
object switch { name s1; phases ABCN; from n1; to n2; status CLOSED; }
object capacitor { name cw; parent n2; phases ABCN; phases_connected ABC; capacitor_A 300 kVAr; capacitor_B 0.2 MVAr;
    capacitor_C 100000; cap_nominal_voltage 7200; nominal_voltage 7200; switchA CLOSED; switchB CLOSED; switchC OPEN; }
object capacitor { name cd; parent n2; phases ABCD; phases_connected ABCD; capacitor_A 300 kVAr; capacitor_B 0.2 MVAr;
    capacitor_C 0; cap_nominal_voltage 12470; nominal_voltage 12470; switchA CLOSED; switchB CLOSED; switchC CLOSED; }
"""
REGULATOR = """
object regulator_configuration { name rc; connect_type WYE_WYE; raise_taps 16; lower_taps 16; regulation 0.1;
    tap_pos_A 5; tap_pos_B -3; tap_pos_C 16; MORE }
object regulator { name r1; phases ABC; from n1; to n2; configuration rc; }
object load { name n2; phases ABCN; nominal_voltage 7200; constant_power_A 300 kW; constant_power_B 250000+80000j;
    constant_power_C 200+90j kVA; }
"""
TYPE_A = REGULATOR.replace("MORE", "Control MANUAL; Type A;")
TYPE_B = REGULATOR.replace("MORE", "Control MANUAL; Type B;")
VOLTAGES = {
    "cables": (CABLES, {
        "m1": ((7121.33, -2.73302), (7253.49, -121.442), (7135.32, 119.833)),
        "m2": ((7122.34, -2.73101), (7252.95, -121.436), (7134.9, 119.826)),
        "m3": ((7107.09, -2.76123), (7245.53, -121.434), (7130.79, 119.88)),
        "m6": ((7125.87, -2.74237), (7258.36, -121.434), (7135.54, 119.834)),
    }),
    "split phase": (SPLIT_PHASE, {
        "n1": ((7309.04, -0.463714), (7315.86, -120.301), (7303.97, 119.806)),
        "tn": ((121.295, -120.713), (121.392, 59.294)),
        "tm": ((118.769, -120.787), (120.443, 59.14)),
    }),
    "transformers": (TRANSFORMERS, {
        "n1": ((7225.13, -0.837716), (7318.08, -120.611), (7298.25, 119.857)),
        "low": ((275.041, -1.61219), (279.975, -121.136), (280.857, 119.747)),
        "low3": ((270.518, -3.73411), (280.39, -121.865)),
    }),
    "capacitors": (CAPACITORS, {"n2": ((7418.4, -1.00691), (7419.3, -120.318), (7281.15, 119.673))}),
    "type A": (TYPE_A, {"n2": ((7505.02, -0.987828), (7161.94, -120.475), (7981.62, 119.612))}),
    "type B": (TYPE_B, {"n2": ((7512.36, -0.987828), (7164.46, -120.475), (8062.25, 119.612))}),
}  # fmt: skip
"""Models that go on after ``HEAD``, with volts and degrees of phases a, b and c of some buses (1 and -2 if split)."""

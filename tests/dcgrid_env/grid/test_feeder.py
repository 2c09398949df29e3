"""Feeder: what is built from tables, per unit, paths, and that nobody can change it."""

import copy
import itertools
import pickle
from dataclasses import FrozenInstanceError, fields

import numpy as np
import pytest

from dcgrid_env import Feeder, FeederError, distflow, load_feeder, sensitivity
from helpers.feeders import BALANCED

ARRAYS = ["p_load_kw", "q_load_kvar", "capacitor_kvar", "parent", "r_ohm", "x_ohm", "x", "y"]
CACHED = ["r_pu", "x_pu", "path", "node_bus", "node_phase", "source_nodes", "load_nodes"]


def assert_same_feeder(a, b):
    for field in fields(Feeder):
        if field.name in ARRAYS:
            np.testing.assert_array_equal(getattr(a, field.name), getattr(b, field.name), strict=True)
        else:
            assert getattr(a, field.name) == getattr(b, field.name)


def test_buses_keep_file_order_behind_the_substation(build):
    feeder = build()
    assert feeder.bus_ids == ("sub", "d", "a", "c", "b")
    assert feeder.n_bus == 5
    assert feeder.p_load_kw.tolist() == [1.0, 40.0, 10.0, 30.0, 20.0]
    assert feeder.q_load_kvar.tolist() == [0.1, 4.0, 1.0, 3.0, 2.0]
    assert feeder.capacitor_kvar.tolist() == [0.0, 400.0, 100.0, 300.0, 200.0]
    assert feeder.x.tolist() == [0.0, 4.5, 1.5, 3.5, 2.5]
    assert feeder.y.tolist() == [0.0, -4.0, -1.0, -3.0, -2.0]
    assert (feeder.name, feeder.base_kv, feeder.v0_pu) == ("hand", 10.0, 1.01)


def test_branch_k_feeds_bus_k_plus_1(build):
    feeder = build()
    assert [feeder.bus_ids[i] for i in feeder.parent] == ["c", "sub", "a", "a"]
    assert feeder.r_ohm.tolist() == [4.0, 1.0, 3.0, 0.0]
    assert feeder.x_ohm.tolist() == [8.0, 2.0, 6.0, 0.0]


def test_per_unit_worked_by_hand(build):
    # 10 kV and 1 MVA: 100 ohm. The switch stays exactly zero.
    feeder = build()
    np.testing.assert_allclose(feeder.r_pu, [0.04, 0.01, 0.03, 0.0], rtol=1e-15, atol=0.0)
    np.testing.assert_allclose(feeder.x_pu, [0.08, 0.02, 0.06, 0.0], rtol=1e-15, atol=0.0)


def test_path_worked_by_hand(build):
    # Branches to d, a, c, b; d hangs on c, c and b on a.
    path = [[0, 0, 0, 0], [1, 1, 1, 0], [0, 1, 0, 0], [0, 1, 1, 0], [0, 1, 0, 1]]
    assert build().path.tolist() == path


def test_without_capacitors_and_coordinates(build):
    feeder = build(capacitor_kvar=None, x=None, y=None)
    assert feeder.capacitor_kvar.tolist() == [0.0] * 5
    assert np.isnan(feeder.x).all()
    assert np.isnan(feeder.y).all()


def test_either_direction_and_any_order_of_the_branches_give_the_same_feeder(build, tables):
    reference = build()
    ends = list(zip(tables["from_bus"], tables["to_bus"], tables["r_ohm"], tables["x_ohm"], strict=True))
    for turned in itertools.product([False, True], repeat=len(ends)):
        rows = [(j, i, r, x) if turn else (i, j, r, x) for (i, j, r, x), turn in zip(ends, turned, strict=True)]
        for order in itertools.permutations(rows):
            i, j, r, x = zip(*order, strict=True)
            assert_same_feeder(build(from_bus=i, to_bus=j, r_ohm=r, x_ohm=x), reference)


def test_index(build):
    feeder = build()
    assert [feeder.index(bus) for bus in feeder.bus_ids] == [0, 1, 2, 3, 4]
    with pytest.raises(FeederError, match=r"'hand' has no bus 'e'.*'sub', 'd'"):
        feeder.index("e")
    assert load_feeder("toy6").index(1) == load_feeder("toy6").index("1") == 1
    for bus in (1.0, True, None):
        with pytest.raises(FeederError, match=f"bus {bus} is neither text nor a whole number"):
            load_feeder("toy6").index(bus)  # pyright: ignore[reportArgumentType]


def test_a_feeder_of_one_bus():
    nothing = {column: [] for column in ("from_bus", "to_bus", "r_ohm", "x_ohm")}
    feeder = Feeder.from_tables(
        name="one", base_kv=1.0, substation=1, v0_pu=1.02, bus_ids=[1], p_load_kw=[5], q_load_kvar=[1], **nothing
    )
    assert feeder.n_bus == 1
    assert distflow(feeder, feeder.p_load_kw, feeder.q_load_kvar).v_pu.tolist() == [1.02]


def test_a_feeder_2000_buses_long():
    n = 2000
    line = {"from_bus": range(1, n), "to_bus": range(n - 1), "r_ohm": [1e-3] * (n - 1), "x_ohm": [1e-3] * (n - 1)}
    feeder = Feeder.from_tables(
        name="long", base_kv=10.0, substation=0, v0_pu=1.0, bus_ids=range(n), p_load_kw=[0.1] * n,
        q_load_kvar=[0.0] * n, **line,
    )  # fmt: skip
    assert feeder.parent.tolist() == list(range(n - 1))
    assert feeder.depth_first.order.tolist() == list(range(n))
    v_pu = distflow(feeder, feeder.p_load_kw, feeder.q_load_kvar).v_pu
    assert (np.diff(v_pu) < 0).all()


@pytest.mark.parametrize("name", BALANCED)
def test_arrays_are_read_only(name):
    feeder = load_feeder(name)
    for field in ARRAYS:
        with pytest.raises(ValueError, match="read-only"):
            getattr(feeder, field)[0] = 1
    with pytest.raises(FrozenInstanceError):
        feeder.v0_pu = 1.1  # pyright: ignore[reportAttributeAccessIssue]


def test_the_arrays_given_are_copied_and_stay_writable(build):
    r_ohm = np.array([4.0, 0.0, 1.0, 3.0])
    feeder = build(r_ohm=r_ohm)
    r_ohm[:] = 9.0
    assert feeder.r_ohm.tolist() == [4.0, 1.0, 3.0, 0.0]


@pytest.mark.parametrize("field", CACHED)
def test_derived_arrays_are_read_only(build, field):
    assert not getattr(build(), field).flags.writeable


@pytest.mark.parametrize("clone", [copy.copy, copy.deepcopy, lambda f: pickle.loads(pickle.dumps(f))])
@pytest.mark.parametrize("used", [False, True])
def test_copies_and_pickles_are_the_same_feeder(build, clone, used):
    feeder = build()
    if used:  # with its derived arrays made and cached
        distflow(feeder, feeder.p_load_kw, feeder.q_load_kvar)
        sensitivity(feeder)
        feeder.index("a")
    twin = clone(feeder)
    assert_same_feeder(twin, feeder)
    assert twin.index("c") == feeder.index("c")
    for field in CACHED:
        np.testing.assert_array_equal(getattr(twin, field), getattr(feeder, field))
    a, b = (distflow(f, f.p_load_kw, f.q_load_kvar) for f in (twin, feeder))
    assert a.v_pu.tobytes() == b.v_pu.tobytes()


@pytest.mark.parametrize("clone", [copy.deepcopy, lambda f: pickle.loads(pickle.dumps(f))])
def test_copies_are_read_only_too(build, clone):
    twin = clone(build())
    assert not any(getattr(twin, field).flags.writeable for field in ARRAYS)


# --- nodes ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", BALANCED)
def test_a_balanced_feeder_has_one_node_at_each_bus(name):
    feeder = load_feeder(name)
    assert feeder.n_node == feeder.n_bus == feeder.n_branch + 1
    assert feeder.node_bus.tolist() == list(range(feeder.n_bus))
    assert feeder.node_phase.tolist() == [0] * feeder.n_bus
    assert feeder.source_nodes.tolist() == [0]
    assert feeder.load_nodes.tolist() == list(range(1, feeder.n_bus))


def test_the_slice_takes_the_load_nodes_without_a_copy(build):
    feeder = build()
    values = np.arange(10.0).reshape(2, 5)
    taken = values[..., feeder.load_slice]
    assert taken.tolist() == values[..., feeder.load_nodes].tolist()
    assert np.shares_memory(taken, values)

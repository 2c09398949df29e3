"""Trees, their depth-first index, loops, and the errors that name buses and branches."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dcgrid_env import FeederError
from dcgrid_env.grid.topology import depth_first, orient


def test_orient_worked_by_hand():
    # 30 is the substation; 10 hangs on 20, 20 and 40 on 30; the branches stand in any order and direction.
    order, parent, branch, loop_ends = orient("f", 30, [10, 20, 30, 40], [10, 40, 30], [20, 30, 20])
    assert order.tolist() == [2, 0, 1, 3]
    assert list(parent) == [2, 0, 0]
    assert branch.tolist() == [0, 2, 1]
    assert loop_ends == []


def test_orient_with_loops_worked_by_hand():
    # The ring sub - a - c - d - b - sub is closed where its sides meet: c and b are reached before d, b first.
    buses = ["sub", "a", "b", "c", "d"]
    order, parent, branch, loop_ends = orient(
        "f", "sub", buses, ["a", "d", "c", "b", "b"], ["sub", "c", "a", "sub", "d"]
    )
    assert order.tolist() == [0, 1, 2, 3, 4]
    assert parent == [0, 0, 1, 2]
    assert branch.tolist() == [0, 3, 2, 4, 1]
    assert loop_ends == [(3, 4)]


@given(st.permutations(range(7)), st.lists(st.booleans(), min_size=7, max_size=7))
def test_the_tree_depends_on_neither_order_nor_direction_of_the_branches(order, turned):
    ends = [(0, 1), (0, 2), (1, 3), (2, 3), (3, 4), (1, 4), (4, 2)]
    expected = orient("f", 0, range(5), *zip(*ends, strict=True))
    shown = [ends[k][::-1] if turn else ends[k] for k, turn in zip(order, turned, strict=True)]
    found = orient("f", 0, range(5), *zip(*shown, strict=True))
    assert found[1] == expected[1]
    assert found[3] == expected[3]
    assert [order[row] for row in found[2]] == expected[2].tolist()


# --- depth-first index ----------------------------------------------------------------------------------------------


@st.composite
def trees(draw):
    """Parents of the buses 1.. of a tree, numbered in any order with the root as bus 0."""
    hang_on = draw(st.lists(st.integers(0, 29), max_size=29))
    n = len(hang_on) + 1
    renamed = [0, *draw(st.permutations(range(1, n)))]
    parent = dict.fromkeys(range(1, n), 0)
    for k, a in enumerate(hang_on):
        parent[renamed[k + 1]] = renamed[a % (k + 1)]
    return [parent[bus] for bus in range(1, n)]


def test_depth_first_worked_by_hand():
    # 0 feeds 2 and 3; 2 feeds 4 and 1.
    index = depth_first([2, 0, 0, 2])
    assert index.order.tolist() == [0, 2, 1, 4, 3]
    assert index.place.tolist() == [0, 2, 1, 4, 3]
    assert index.parent.tolist() == [0, 0, 1, 1, 0]
    assert index.end.tolist() == [5, 4, 3, 4, 5]


@given(trees())
def test_each_subtree_is_one_slice_of_the_order(parent):
    n = len(parent) + 1
    subtree = [{bus} for bus in range(n)]
    for bus in range(1, n):
        above = bus
        while above:
            above = parent[above - 1]
            subtree[above].add(bus)
    index = depth_first(np.array(parent, dtype=np.intp))
    assert sorted(index.order) == list(range(n))
    for at, bus in enumerate(index.order):
        assert index.place[bus] == at
        assert set(index.order[at : index.end[at]]) == subtree[bus]
        assert index.order[index.parent[at]] == (parent[bus - 1] if at else 0)


def test_the_index_cannot_be_written():
    assert not any(array.flags.writeable for array in depth_first([0, 1]))


# --- what is no tree ------------------------------------------------------------------------------------------------


def test_duplicate_bus(build):
    with pytest.raises(FeederError, match=r"'hand': duplicate bus a, c; give each bus one row"):
        build(bus_ids=["c", "a", "sub", "c", "a"])


def test_unknown_substation(build):
    with pytest.raises(FeederError, match=r"'hand': substation 'grid' is not among its buses \['d', 'a', 'sub'"):
        build(substation="grid")


@pytest.mark.parametrize("end", ["from_bus", "to_bus"])
def test_unknown_bus_in_a_branch(build, tables, end):
    ends = {"from_bus": tables["from_bus"], "to_bus": tables["to_bus"]}
    ends[end] = [*ends[end][:3], "nowhere"]
    name = f"{ends['from_bus'][3]}-{ends['to_bus'][3]}"
    with pytest.raises(FeederError, match=f"'hand': branch {name} names the unknown bus 'nowhere'"):
        build(**ends)


def test_self_loop(build, tables):
    with pytest.raises(FeederError, match=r"branch b-b joins a bus with itself; leave it out"):
        build(from_bus=["d", "a", "a", "c", "b"], to_bus=["c", "b", "sub", "a", "b"], r_ohm=[1.0] * 5, x_ohm=[1.0] * 5)


def test_a_branch_without_impedance_closes_no_loop_of_such_branches(build):
    # a - b is a switch of zero already, so any current could go round a second one.
    ends = {"from_bus": ["d", "a", "a", "c", "b"], "to_bus": ["c", "b", "sub", "a", "a"]}
    with pytest.raises(FeederError, match=r"'hand': branch b-a: r_ohm and x_ohm are 0, and it closes a loop"):
        build(**ends, r_ohm=[4.0, 0.0, 1.0, 3.0, 0.0], x_ohm=[8.0, 0.0, 2.0, 6.0, 0.0])
    assert build(**ends, r_ohm=[4.0, 0.0, 1.0, 3.0, 0.1], x_ohm=[8.0, 0.0, 2.0, 6.0, 0.0]).n_loop == 1


def test_too_many_loops_are_refused_with_their_number_and_buses(build, tables):
    further = ["c"] * 9, ["d"] * 9
    ends = {"from_bus": [*tables["from_bus"], *further[0]], "to_bus": [*tables["to_bus"], *further[1]]}
    with pytest.raises(FeederError, match=r"has 9 loops and at most 8 are solved: branch c-d closes .*\['c', 'd'\]"):
        build(**ends, r_ohm=[1.0] * 13, x_ohm=[1.0] * 13)
    eight = {name: column[:-1] for name, column in ends.items()}
    assert build(**eight, r_ohm=[1.0] * 12, x_ohm=[1.0] * 12).n_loop == 8


def test_island(build):
    with pytest.raises(FeederError, match=r"more than one root: the buses \['d', 'c'\] are not connected.*'sub'"):
        build(from_bus=["d", "a", "a"], to_bus=["c", "b", "sub"], r_ohm=[1.0] * 3, x_ohm=[1.0] * 3)


def test_island_with_a_loop_and_as_many_branches_as_a_tree(build):
    # Four branches for five buses, so counting alone does not find it.
    with pytest.raises(FeederError, match=r"the buses \['d', 'c', 'b'\] are not connected to the substation"):
        build(from_bus=["d", "c", "b", "a"], to_bus=["c", "b", "d", "sub"])


def test_isolated_bus(build):
    with pytest.raises(FeederError, match=r"'hand': isolated bus \['b'\]"):
        build(from_bus=["d", "a", "c"], to_bus=["c", "sub", "a"], r_ohm=[1.0] * 3, x_ohm=[1.0] * 3)


def test_a_substation_without_branches(build):
    with pytest.raises(FeederError, match=r"the buses \['d', 'a', 'c', 'b'\] are not connected to the substation"):
        build(from_bus=["d", "a", "c"], to_bus=["c", "b", "a"], r_ohm=[1.0] * 3, x_ohm=[1.0] * 3)

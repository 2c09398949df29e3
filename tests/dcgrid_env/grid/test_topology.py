"""What is not a radial feeder, and that the message names the buses and branches."""

import pytest

from dcgrid_env import FeederError
from dcgrid_env.grid.topology import orient


def test_orient_worked_by_hand():
    # 30 is the substation; 10 hangs on 20, 20 and 40 on 30; the branches stand in any order and direction.
    order, parent, branch = orient("f", 30, [10, 20, 30, 40], [10, 40, 30], [20, 30, 20])
    assert order.tolist() == [2, 0, 1, 3]
    assert list(parent) == [2, 0, 0]
    assert branch.tolist() == [0, 2, 1]


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
    with pytest.raises(FeederError, match=r"not radial: branch b-b joins a bus with itself"):
        build(from_bus=["d", "a", "a", "c", "b"], to_bus=["c", "b", "sub", "a", "b"], r_ohm=[1.0] * 5, x_ohm=[1.0] * 5)


def test_loop_names_its_buses_and_no_others(build):
    # sub - a, a - c, c - d, d - b and b - a: the loop is a, c, d, b without the substation.
    with pytest.raises(FeederError, match=r"'hand' is not radial: branch (\w)-(\w) closes a loop") as caught:
        build(from_bus=["sub", "a", "c", "d", "b"], to_bus=["a", "c", "d", "b", "a"], r_ohm=[1.0] * 5, x_ohm=[1.0] * 5)
    listed = str(caught.value).split("[")[1].split("]")[0].replace("'", "").split(", ")
    assert sorted(listed) == ["a", "b", "c", "d"]
    branches = {frozenset(pair) for pair in ("ac", "cd", "db", "ba")}
    assert {frozenset(pair) for pair in zip(listed, [*listed[1:], listed[0]], strict=True)} == branches


def test_parallel_branches_are_a_loop(build):
    with pytest.raises(FeederError, match=r"branch \w-\w closes a loop over the buses \['[cd]', '[cd]'\]"):
        build(from_bus=["d", "a", "a", "c", "c"], to_bus=["c", "b", "sub", "a", "d"], r_ohm=[1.0] * 5, x_ohm=[1.0] * 5)


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

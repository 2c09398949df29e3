"""The ends of a feeder, compared with their documented rule."""

import numpy as np
import pytest

from dcgrid_env import FEEDERS, Feeder, load_feeder
from dcgrid_env.scenario.placement import branch_impedance, feeder_ends


def everywhere(feeder):
    allowed = np.ones(feeder.n_bus, dtype=bool)
    allowed[0] = False
    return allowed


def paths(feeder):
    """Branches between each bus and the source."""
    found = [set() for _ in range(feeder.n_bus)]
    for i in feeder.depth_first.order[1:].tolist():
        found[i] = found[feeder.parent[i - 1]] | {i - 1}
    return found


@pytest.mark.parametrize("name", FEEDERS)
def test_each_end_adds_the_most_impedance_to_the_paths_before_it(name):
    feeder = load_feeder(name)
    allowed = everywhere(feeder)
    allowed[feeder.n_bus // 2 :: 7] = False
    z_pu, path = branch_impedance(feeder), paths(feeder)
    behind = {k + 1 for i in np.flatnonzero(allowed) for k in path[i] if k != i - 1}
    left = [i for i in np.flatnonzero(allowed).tolist() if i not in behind]
    found = feeder_ends(feeder, allowed)
    assert sorted(found) == left
    covered = set()
    for end in found:
        most = max(z_pu[list(path[i] - covered)].sum() for i in left)
        assert z_pu[list(path[end] - covered)].sum() == pytest.approx(most, abs=1e-12)
        covered |= path[end]
        left.remove(end)


def test_the_ends_of_the_published_study_come_first_and_on_different_branches():
    feeder = load_feeder("ieee33")
    assert [feeder.bus_ids[i] for i in feeder_ends(feeder, everywhere(feeder))] == ["18", "33", "22", "25"]


def test_a_long_chain_has_one_end_and_needs_no_recursion():
    n = 5000
    chain = Feeder.from_tables(
        name="chain", base_kv=11.0, substation=0, v0_pu=1.0, bus_ids=range(n), p_load_kw=[0.0] * n,
        q_load_kvar=[0.0] * n, from_bus=range(n - 1), to_bus=range(1, n), r_ohm=[1e-4] * (n - 1),
        x_ohm=[1e-4] * (n - 1),
    )  # fmt: skip
    assert feeder_ends(chain, everywhere(chain)) == [n - 1]


def test_the_positive_sequence_of_a_line_is_that_of_its_own_less_its_mutual_impedance():
    feeder = load_feeder("ieee34-3ph")
    i = feeder.bus_ids.index("802")
    b = feeder.branches.b[i]
    own, mutual = np.diag(b).mean(), b[~np.eye(3, dtype=bool)].mean()
    assert branch_impedance(feeder)[i - 1] == pytest.approx(abs(own - mutual))

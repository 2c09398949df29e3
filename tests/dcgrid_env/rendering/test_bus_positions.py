"""Positions of buses in a drawing, on the feeders that ship and on trees drawn at random."""

import numpy as np
import pytest

from dcgrid_env import Feeder, load_feeder
from dcgrid_env.rendering.bus_positions import positions
from helpers.feeders import BALANCED


def feeder_of(parent, x=None, y=None):
    """A feeder whose branch k runs from bus ``parent[k]`` to bus k + 1."""
    n = len(parent) + 1
    return Feeder.from_tables(
        name="tree", base_kv=1.0, substation=0, v0_pu=1.0, bus_ids=range(n), p_load_kw=[0.0] + [1.0] * (n - 1),
        q_load_kvar=[0.0] * n, from_bus=list(parent), to_bus=list(range(1, n)), r_ohm=[0.1] * (n - 1),
        x_ohm=[0.1] * (n - 1), x=x, y=y,
    )  # fmt: skip


def trees():
    yield [0]
    yield [0] * 7
    yield list(range(9))
    rng = np.random.default_rng(5)
    for n in (5, 20, 60, 120):
        for reach in (1, 3, n):
            yield [int(rng.integers(max(0, k - reach), k + 1)) for k in range(n)]


def distance_to_segments(point, a, b):
    along = b - a
    share = np.clip(((point - a) * along).sum(1) / (along**2).sum(1), 0.0, 1.0)
    return np.linalg.norm(a + share[:, None] * along - point, axis=1)


def crossings(a, b):
    """Pairs of segments a[i]-b[i] that cross within both."""

    def side(p, q, r):
        return np.sign(np.round((q[0] - p[0]) * (r[1] - p[1]) - (q[1] - p[1]) * (r[0] - p[0]), 9))

    return [
        (i, j)
        for i in range(len(a))
        for j in range(i)
        if side(a[i], b[i], a[j]) * side(a[i], b[i], b[j]) < 0 and side(a[j], b[j], a[i]) * side(a[j], b[j], b[i]) < 0
    ]


@pytest.mark.parametrize("name", BALANCED)
def test_every_named_feeder_has_distinct_finite_positions_the_same_each_time(name):
    feeder = load_feeder(name)
    xy = positions(feeder)
    assert xy.shape == (feeder.n_bus, 2)
    assert np.isfinite(xy).all()
    apart = np.linalg.norm(xy[:, None] - xy, axis=2) + np.where(np.eye(len(xy)), np.inf, 0.0)
    assert apart.min() > 0.002 * np.ptp(xy, axis=0).max()
    np.testing.assert_array_equal(xy, positions(feeder))


@pytest.mark.parametrize("name", ["toy6", "ieee123"])
def test_published_coordinates_are_kept(name):
    feeder = load_feeder(name)
    np.testing.assert_array_equal(positions(feeder), np.column_stack((feeder.x, feeder.y)))


@pytest.mark.parametrize("name", ["ieee33", "das69", "khodr141"])
def test_the_trunk_of_a_feeder_without_coordinates_is_straight_and_begins_at_the_left(name):
    feeder = load_feeder(name)
    xy = positions(feeder)
    longest = np.flatnonzero(feeder.path[feeder.path.sum(1).argmax()]) + 1
    assert (xy[longest, 1] == xy[0, 1]).all()
    assert (np.diff(np.sort(np.append(xy[longest, 0], xy[0, 0]))) == 1.0).all()
    assert xy[0, 0] == xy[:, 0].min()
    assert (xy[1:, 0] >= xy[feeder.parent, 0]).all()


@pytest.mark.parametrize(
    "feeder", [load_feeder(n) for n in ("ieee33", "das69", "khodr141")] + [*map(feeder_of, trees())]
)
def test_branches_of_a_computed_layout_neither_cross_nor_pass_over_a_bus(feeder):
    xy = positions(feeder)
    a, b = xy[feeder.parent], xy[1:]
    assert crossings(a, b) == []
    for i in range(feeder.n_bus):
        others = (feeder.parent != i) & (np.arange(1, feeder.n_bus) != i)
        if others.any():
            assert distance_to_segments(xy[i], a[others], b[others]).min() > 0.05


@pytest.mark.parametrize("missing", [[0], [4], [0, 7, 50], list(range(60))])
def test_a_bus_without_coordinates_goes_beside_a_neighbour_and_the_others_stay(missing):
    published = load_feeder("ieee123")
    x, y = published.x.copy(), published.y.copy()
    x[missing] = np.nan
    feeder = feeder_of(published.parent, x, y)
    xy = positions(feeder)
    given = np.setdiff1d(np.arange(feeder.n_bus), missing)
    np.testing.assert_array_equal(xy[given], np.column_stack((x, y))[given])
    assert len(np.unique(xy, axis=0)) == feeder.n_bus
    lengths = np.linalg.norm(xy[1:] - xy[feeder.parent], axis=1)
    before = np.linalg.norm(
        np.diff(np.stack((published.x, published.y))[:, [feeder.parent, np.arange(1, 123)]], axis=1)
    )
    assert np.isfinite(lengths).all()
    assert lengths.max() <= before


def test_two_buses_at_one_place_are_parted():
    xy = positions(feeder_of([0, 1, 2], [0.0, 1.0, 1.0, 2.0], [0.0, 0.0, 0.0, 0.0]))
    assert np.linalg.norm(xy[1] - xy[2]) > 0.1
    assert xy[[0, 1, 3]].tolist() == [[0.0, 0.0], [1.0, 0.0], [2.0, 0.0]]

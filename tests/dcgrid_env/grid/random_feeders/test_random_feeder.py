"""Random feeders: radial, with headroom, drawn as their style says, and the same bits everywhere."""

import time

import numpy as np
import pytest

from dcgrid_env import FeederError, distflow, random_feeder
from dcgrid_env.core.digest import digest
from dcgrid_env.grid.random_feeders.drawn import HEADROOM, LARGEST_LOADING, LARGEST_REACH_PU, draw_feeder
from dcgrid_env.grid.random_feeders.styles import STYLES
from docs.studies.grids.random_feeders import PUBLISHED, drawn_figures

DRAWS = 8
COLUMNS = ("base_kv", "v0_pu", "bus_ids", "p_load_kw", "q_load_kvar", "parent", "r_ohm", "x_ohm", "rating_a", "x", "y")
HASHES = {
    ("urban", 60, 0): "672731550ad29072",
    ("rural", 60, 1): "1df750cb0233af32",
    ("european-lv", 100, 2): "a74867e9ca0117d4",
    ("us-mv", 60, 3): "85f71dc34f5baf99",
    ("us-mv", 1000, 2**64 - 1): "952e9c05671a42a2",
}
"""Columns of some feeders, which must never change while the version of the generator stays."""


@pytest.mark.parametrize(("style", "n_bus", "seed"), HASHES)
def test_the_bits_are_fixed(style, n_bus, seed):
    feeder = random_feeder(seed, n_bus=n_bus, style=style)
    assert digest((name, getattr(feeder, name)) for name in COLUMNS) == HASHES[style, n_bus, seed]


@pytest.mark.parametrize("n_bus", [10, 61])
@pytest.mark.parametrize("style", STYLES)
def test_every_draw_is_a_feeder_with_headroom(style, n_bus):
    for seed in range(DRAWS):
        feeder = random_feeder(seed, n_bus=n_bus, style=style)
        assert feeder.n_bus == n_bus
        assert (feeder.parent < np.arange(1, n_bus)).all()  # numbered depth first
        assert len(np.unique(np.stack((feeder.x, feeder.y)), axis=1).T) > n_bus // 2
        load = np.stack((feeder.p_load_kw, feeder.q_load_kvar))
        for times, lowest in ((1.0, 1.0 - 1.2 * STYLES[style].drop_pu[1]), (HEADROOM, 0.65)):
            solved = distflow(feeder, times * load[:1], times * load[1:], 1.0)
            assert solved.converged.all()
            assert lowest < solved.v_pu.min() < 1.0


@pytest.mark.parametrize("style", STYLES)
def test_conductors_carry_their_current_and_grow_towards_the_substation(style):
    for seed in range(DRAWS):
        drawn = draw_feeder(seed, 80, STYLES[style], None)
        tree, ampacity_a = drawn.tree, drawn.ampacity_a
        flow_kva = np.hypot(tree.downstream(drawn.p_kw[1:]), tree.downstream(drawn.q_kvar[1:]))
        assert (flow_kva / (np.sqrt(3.0) * STYLES[style].base_kv) <= (LARGEST_LOADING + 1e-9) * ampacity_a).all()
        inner = np.flatnonzero(tree.parent > 0)
        largest = {family[-1].ampacity_a for _, family in STYLES[style].conductors}
        grows = ampacity_a[tree.parent[inner] - 1] >= ampacity_a[inner]
        assert (grows | np.isin(ampacity_a[tree.parent[inner] - 1], list(largest))).all()
        reach = max(tree.along(drawn.r_ohm).max(), tree.along(drawn.x_ohm).max()) / STYLES[style].base_kv ** 2 / 1e3
        assert reach * drawn.p_kw.sum() <= LARGEST_REACH_PU


@pytest.mark.parametrize("style", STYLES)
def test_statistics_are_those_of_published_feeders(style):
    """Medians over draws lie within what published feeders of the style have, widened by a quarter."""
    generated = drawn_figures(style, 80, 24)
    for name in ("ends", "mean_hops", "trunk", "length_m", "r_by_x", "loaded", "mean_kw", "power_factor", "drop_pu"):
        known = [getattr(net, name) for net in PUBLISHED[style] if getattr(net, name) == getattr(net, name)]
        if len(known) > 1:
            middle = np.median([getattr(feeder, name) for feeder in generated])
            assert 0.75 * min(known) <= middle <= 1.25 * max(known), name


def test_a_load_that_is_given_is_kept_and_seeds_give_other_feeders():
    feeders = [random_feeder(seed, n_bus=60, style="us-mv", load_kw=4000.0) for seed in range(20)]
    assert all(feeder.p_load_kw.sum() == pytest.approx(4000.0, rel=1e-3) for feeder in feeders)
    assert len({digest([("", feeder)]) for feeder in feeders}) == 20


@pytest.mark.slow
def test_ten_thousand_buses_take_about_ten_times_what_a_thousand_take():
    began_s = time.perf_counter()
    random_feeder(0, n_bus=1_000, style="rural")
    small_s = time.perf_counter() - began_s
    assert random_feeder(0, n_bus=10_000, style="rural").depth_first.end[0] == 10_000
    assert time.perf_counter() - began_s < 40 * small_s + 5.0


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({"style": "lunar"}, "no style 'lunar'; `dcgrid list feeders` lists all"),
        ({"n_bus": 9}, "n_bus is 9; give a whole number from 10 to 100,000"),
        ({"n_bus": 60.0}, "n_bus is 60.0"),
        ({"load_kw": -1.0}, "load_kw is -1.0; give more than 0"),
        ({"load_kw": float("nan")}, "load_kw is nan"),
        ({"n_bus": 20, "load_kw": 1e6}, "carries 1e[+]06 kW"),
    ],
)
def test_bad_input_names_field_value_and_remedy(given, said):
    with pytest.raises(FeederError, match=said):
        random_feeder(0, **given)
    with pytest.raises(ValueError, match="seed is -1"):
        random_feeder(-1)
    with pytest.raises(ValueError, match="less than 2"):
        random_feeder(2**64)

"""Families of random feeders: who is in them, and what they refuse."""

import numpy as np
import pytest

from dcgrid_env import RandomFeeders, ScenarioError, make_scenario
from dcgrid_env.core.checked import FieldError
from dcgrid_env.core.digest import digest
from dcgrid_env.grid import FeederError
from dcgrid_env.grid.random_feeders.family import HELD_OUT

FAMILY = RandomFeeders(n_bus=20, style="us-mv", load_kw=1000.0, batch=4)
HELD = ("validation", "test", "ood")


def keys(split, seeds, number=0):
    seeds = np.array(seeds, np.uint64)
    return FAMILY.keys(split, seeds, np.full_like(seeds, number)).tolist()


def test_a_batch_of_training_seeds_shares_a_feeder_and_the_next_has_another():
    of_seeds = keys("train", range(12))
    assert [of_seeds.index(key) for key in of_seeds] == [0] * 4 + [4] * 4 + [8] * 4
    assert not set(of_seeds) & set(keys("train", range(12), number=1))


@pytest.mark.parametrize("split", HELD)
def test_a_held_out_split_has_64_feeders_in_turn(split):
    of_seeds = keys(split, range(2 * HELD_OUT))
    assert len(set(of_seeds)) == HELD_OUT
    assert of_seeds[:HELD_OUT] == of_seeds[HELD_OUT:]
    assert keys(split, range(HELD_OUT), number=1) == of_seeds[1 : HELD_OUT + 1]
    assert keys(split, [2**64 - 1], number=2**64 - 1) == [of_seeds[HELD_OUT - 2]]


@pytest.mark.slow
def test_no_feeder_is_in_two_splits_and_all_64_differ():
    splits = [set(keys(split, range(64))) for split in HELD] + [set(keys("train", range(0, 4000, 4)))]
    assert len(set.union(*splits)) == sum(map(len, splits)) == 3 * 64 + 1000
    assert len({digest([("", FAMILY.feeder("test", key))]) for key in keys("test", range(64))}) == 64


@pytest.mark.slow
def test_members_share_buses_and_load_and_stay_within_reach():
    for split in HELD:
        for key in keys(split, range(6)):
            feeder = FAMILY.feeder(split, key)
            assert feeder is FAMILY.feeder(split, key)
            assert feeder.bus_ids == FAMILY.bus_ids
            assert feeder.p_load_kw.sum() == pytest.approx(1000.0, rel=2e-3)
            assert (feeder.p_load_kw > 0).sum() >= FAMILY.least_loaded
            assert max(feeder.path @ feeder.r_ohm) / feeder.base_kv**2 <= FAMILY.largest_drop_pu_per_mw
            assert feeder.base_kv == (20.0 if split == "ood" else 12.47)


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({"style": "lunar"}, "style is 'lunar'; choose one of urban"),
        ({"n_bus": 5}, "n_bus is 5; give a whole number of at least 10"),
        ({"load_kw": 0.0}, "load_kw is 0.0"),
        ({"batch": 0}, "batch is 0"),
        ({"ood": "urban"}, "ood is 'urban'; choose one of rural"),
        ({"version": 2}, "version is 2; choose one of 1"),
    ],
)
def test_a_field_that_cannot_be_is_refused_by_name(given, said):
    with pytest.raises(FieldError, match=said):
        RandomFeeders(**given)


def test_what_one_feeder_has_is_refused_with_its_remedy():
    with pytest.raises(AttributeError, match=r"has no r_ohm: it is many feeders; Scenario.member\(seed\).feeder"):
        _ = FAMILY.r_ohm
    with pytest.raises(FeederError, match="no bus 20; its buses are 0 to 19"):
        FAMILY.index(20)
    with pytest.raises(FeederError, match="no style for the split 'ood'"):
        RandomFeeders(ood=None).style_of("ood")
    with pytest.raises(ScenarioError, match=r"feeder.size is no field; its fields are n_bus"):
        make_scenario("ieee33", feeder={"size": 3})

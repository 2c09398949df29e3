"""The shipped values of hindsight: of these very scenarios and episodes, and recomputed for some."""

import numpy as np
import pytest

from dcgrid_env import PRESETS, make_scenario
from dcgrid_env.baselines import make_controller, published, rollout
from dcgrid_env.baselines.hindsight import hindsight
from dcgrid_env.baselines.published import _shipped

EPISODES = 100


@pytest.mark.parametrize("name", PRESETS)
def test_every_preset_has_its_hundred_test_episodes(name):
    values = published(make_scenario(name, split="test"))
    assert values is not None, "the preset has changed; make its values anew with dcgrid hindsight"
    assert values.seeds.tolist() == list(range(EPISODES))
    assert np.isfinite(values.J).all()
    assert len(set(values.episode_hashes)) == EPISODES
    # Above the bound by what a linear program around the trajectory leaves open.
    assert (values.bound - 1e-6 < values.J).all()
    assert (values.J - values.bound < 0.01 * values.J).all()
    content = _shipped(name)
    assert content is not None
    assert content["command"] == f"dcgrid hindsight --scenarios {name} --split test --episodes {EPISODES}"


@pytest.mark.parametrize("name", PRESETS)
def test_episodes_are_drawn_here_as_there(name):
    scenario = make_scenario(name, split="test")
    values = published(scenario)
    assert values is not None
    values.check_episodes(scenario, 3)
    with pytest.raises(ValueError, match=f"episode 0 of '{name}', test split, has the hash"):
        values._replace(episode_hashes=("0" * 16,)).check_episodes(scenario, 1)


@pytest.mark.parametrize("name", ["toy6", "ieee33-weak", "mixed", "sync"])
def test_a_value_comes_out_again(name):
    scenario = make_scenario(name, split="test")
    values = published(scenario)
    assert values is not None
    found = hindsight(scenario, 41)
    # HiGHS may end at another corner of the same optimum elsewhere; the costs agree.
    assert pytest.approx(values.J[41], rel=1e-4) == found.J
    assert found.bound == pytest.approx(values.bound[41], rel=1e-4)


@pytest.mark.parametrize("name", PRESETS)
def test_there_is_headroom(name):
    """No control is bad, hindsight is good, and the tuned droop lies between, with room on both sides."""
    scenario = make_scenario(name, split="test")
    values = published(scenario)
    assert values is not None
    j = {c: rollout(scenario, make_controller(c, scenario), range(20)).costs() for c in ("none", "droop-tuned")}
    none, droop, best = j["none"].mean(), j["droop-tuned"].mean(), values.J[:20].mean()
    assert best < droop < none
    assert (droop - best) > 0.02 * none
    assert (none - droop) > 0.1 * none
    # On every single episode, nobody beats foresight by more than its gap.
    for cost in j.values():
        assert (cost > values.bound[:20] - 1e-6).all()
        assert (cost > values.J[:20] - (values.J - values.bound)[:20] - 1e-6).all()


def test_another_scenario_has_none():
    assert published(make_scenario("ieee33", split="validation")) is None
    assert published(make_scenario("ieee33", split="test", horizon=60)) is None
    assert published(make_scenario("ieee33", split="test", name="mine")) is None

import numpy as np
import pytest

from docs.studies.gradient_cosine import GradientCosine, agreement, team_advantages


def test_counterfactual_gradients_agree_and_those_of_the_teams_return_less():
    found = agreement("ieee33-weak", seed=0, num_envs=12, steps=12, gamma=0.97)
    assert found.counterfactual > 0.7
    assert found.team < found.counterfactual


def test_a_teams_return_is_discounted_from_each_step_on_and_less_its_mean():
    costs = np.array([[1.0, 3.0], [2.0, 2.0]])
    np.testing.assert_allclose(team_advantages(costs, 0.5), [[1.0, -1.0], [0.0, 0.0]])


def test_the_command_prints_a_line_a_scenario_and_refuses_what_cannot_be(capsys):
    GradientCosine(scenarios="toy6", num_envs=2, steps=2, seeds=1).run()
    assert capsys.readouterr().out.splitlines()[-1].startswith("| `toy6` | ")
    with pytest.raises(ValueError, match=r"gamma is 1\.5; give more than 0 and at most 1"):
        GradientCosine(gamma=1.5).run()
    with pytest.raises(ValueError, match="seeds: must be at least 1, got 0"):
        GradientCosine(seeds=0).run()
    with pytest.raises(ValueError, match="num_envs is 1; give at least 2"):
        GradientCosine(num_envs=1).run()
    with pytest.raises(ValueError, match="scenario 'smoothing' has smoothing at"):
        GradientCosine(scenarios="toy6,smoothing").run()
    assert not capsys.readouterr().out

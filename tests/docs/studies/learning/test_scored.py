"""Several training seeds and controllers on the test split."""

import numpy as np
import pytest

from dcgrid_env.baselines import Droop, make_controller
from docs.studies.learning.scored import controller_on_test, droop_on_test, on_test, score, scored

EPISODES = 4


def test_the_tuned_droop_scores_nothing():
    droop = droop_on_test("toy6", EPISODES)
    found = score(droop, droop)
    assert found is not None
    assert found.value == 0.0


def test_seeds_enter_with_their_mean_cost():
    laws = [Droop(k_q_mvar_per_pu_s=gain) for gain in (1.0, 5.0)]
    both = scored(laws, "toy6", EPISODES)
    alone = [scored([law], "toy6", EPISODES) for law in laws]
    np.testing.assert_allclose(both.mean.J, 0.5 * (alone[0].mean.J + alone[1].mean.J))
    assert both.mean.means["J"] == pytest.approx(both.mean.J.mean())
    droop = droop_on_test("toy6", EPISODES)
    values = sorted(found.value for one in alone if (found := one.score(droop)))
    assert both.spread(droop) == pytest.approx(tuple(values))
    # The score of a mean cost is the mean score: numerator and denominator are means over the same episodes.
    together = both.score(droop)
    assert together is not None
    assert together.value == pytest.approx(np.mean(values))
    assert alone[0].spread(droop) is None


def test_cost_but_for_waiting_is_what_the_other_terms_come_to():
    means = controller_on_test("droop", "toy6", EPISODES).mean.means
    assert means["delay_mean_s"] > 0
    assert means["J_but_delay"] < means["J"]
    no_clock = scored([make_controller("none", on_test("toy6"))], "toy6", EPISODES).mean.means
    assert no_clock["J_but_delay"] == pytest.approx(no_clock["J"])

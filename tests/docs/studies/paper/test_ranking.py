"""Rank correlations and swapped pairs, on rows ranked by hand."""

import numpy as np
import pytest
from scipy.stats import kendalltau, spearmanr

from docs.studies.paper.ranking import agreement, correlations, ranks


def rows(*means, noise=0.0):
    """Rows a, b, c, .. of four episodes around these means; the noise is the same in no two of them."""
    sway = noise * np.array([1.0, -1.0, 1.0, -1.0])
    return {name: mean + i * sway for i, (name, mean) in enumerate(zip("abcd", means, strict=False))}


def test_the_same_order_agrees_wholly():
    found = agreement({"": rows(1.0, 2.0, 3.0)}, {"": rows(10.0, 11.0, 40.0)})
    assert found == {"kendall_tau": pytest.approx(1.0), "spearman_rho": pytest.approx(1.0), "pairs": 3, "swapped": []}


def test_one_swap_of_six_pairs_by_hand():
    found = agreement({"": rows(1.0, 2.0, 3.0, 4.0)}, {"": rows(1.0, 3.0, 2.0, 4.0)})
    assert found["kendall_tau"] == pytest.approx((5 - 1) / 6)
    assert found["spearman_rho"] == pytest.approx(1.0 - 6.0 * 2.0 / (4 * 15))
    assert found["pairs"] == 6
    assert found["swapped"] == [{"group": "", "better": "b", "worse": "c", "certain": True}]


@pytest.mark.parametrize(("noise", "certain"), [(0.1, True), (10.0, False)])
def test_a_swap_within_the_noise_of_either_feeder_is_not_certain(noise, certain):
    for one, other in (
        (rows(1.0, 2.0, noise=noise), rows(2.0, 1.0)),
        (rows(1.0, 2.0), rows(2.0, 1.0, noise=noise)),
    ):
        (pair,) = agreement({"": one}, {"": other})["swapped"]
        assert pair["certain"] is certain


def test_a_swap_of_no_size_is_not_certain():
    (pair,) = agreement({"": rows(1.0, 2.0)}, {"": rows(1.0005, 1.0)})["swapped"]
    assert pair["certain"] is False


def test_groups_are_ranked_apart():
    found = agreement(
        {"1": rows(1.0, 2.0), "2": rows(5.0, 6.0)},
        {"1": rows(2.0, 1.0), "2": rows(5.0, 6.0)},
    )
    assert found["kendall_tau"] == pytest.approx(0.0)
    assert found["pairs"] == 2
    assert [pair["group"] for pair in found["swapped"]] == ["1"]


def test_correlations_are_those_of_scipy_with_ties_too():
    random = np.random.default_rng(0)
    for _ in range(20):
        one, other = random.integers(0, 6, (2, 12)).astype(float)
        found = correlations(one.tolist(), other.tolist())
        assert found == pytest.approx((kendalltau(one, other)[0], spearmanr(one, other)[0]))


def test_rows_that_are_all_alike_have_no_order_and_swap_nothing():
    found = agreement({"": rows(1.0, 2.0)}, {"": rows(3.0, 3.0)})
    assert found["kendall_tau"] is None
    assert found["spearman_rho"] is None
    assert found["swapped"] == []


def test_places():
    assert ranks([0.3, 0.1, 0.2]) == [3, 1, 2]
    assert ranks([0.2, 0.1, 0.2]) == [2, 1, 3]

"""Whether two feeders rank the same rows alike: rank correlations, and the pairs that change places."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

Rows = Mapping[str, np.ndarray]
"""A figure of every episode, (n_episode,), by the name of its row; lower is better."""
STANDARD_ERRORS = 2.0
"""A difference of so many standard errors counts as one."""


def agreement(one: Mapping[str, Rows], other: Mapping[str, Rows]) -> dict[str, Any]:
    """Compare how two feeders rank rows by their means over episodes.

    Parameters
    ----------
    one, other
        Groups of rows by name, the same in both; rows are ranked within their group. Episodes are paired.

    Returns
    -------
    ``kendall_tau`` (b) and ``spearman_rho``, means over the groups, None where all rows of a group are alike;
    ``pairs``, how many there are; ``swapped``, a record of each pair that changes places: ``better`` and ``worse`` on
    the first feeder, ``certain`` where the difference is beyond twice its standard error on both.
    """
    found, swapped, pairs = [], [], 0
    for group, here in one.items():
        there = other[group]
        found.append(correlations(*([float(rows[name].mean()) for name in here] for rows in (here, there))))
        for better, worse in itertools.permutations(here, 2):
            pairs += 1
            apart = [_apart(rows[worse], rows[better]) for rows in (here, there)]
            if apart[0][0] > 0.0 > apart[1][0]:
                certain = all(abs(mean) > STANDARD_ERRORS * error for mean, error in apart)
                swapped.append({"group": group, "better": better, "worse": worse, "certain": certain})
    means = np.mean(found, axis=0).tolist()
    tau, rho = (None if np.isnan(mean) else mean for mean in means)
    return {"kendall_tau": tau, "spearman_rho": rho, "pairs": pairs // 2, "swapped": swapped}


def correlations(one: Sequence[float], other: Sequence[float]) -> tuple[float, float]:
    """Kendall's tau b and Spearman's rho of two columns of values, each NaN where the values of a column are equal."""
    above = [np.sign(np.subtract.outer(values, values)) for values in (one, other)]
    # How many lie below less how many lie above is linear in the rank, equal values at their mean rank.
    place = [signs.sum(axis=1) for signs in above]
    tau, rho = (
        float((a * b).sum() / spread) if (spread := np.sqrt((a * a).sum() * (b * b).sum())) else np.nan
        for a, b in (above, place)
    )
    return tau, rho


def _apart(a: np.ndarray, b: np.ndarray) -> tuple[float, float]:
    """Mean difference over episodes and its standard error, paired."""
    difference = a - b
    return float(difference.mean()), float(difference.std(ddof=1) / np.sqrt(len(difference)))


def ranks(values: Sequence[float]) -> list[int]:
    """The place of each value, 1 the lowest; of equal ones the first comes first."""
    order = np.argsort(np.argsort(values, kind="stable"), kind="stable")
    return [int(place) + 1 for place in order]

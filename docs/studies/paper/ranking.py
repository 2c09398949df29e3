"""Whether two feeders rank the same rows alike: rank correlations, and the pairs that change places."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

Rows = Mapping[str, np.ndarray]
"""A figure of every episode, (n_episode,), by the name of its row; lower is better."""
STANDARD_ERRORS = 2.0
"""A difference must be beyond so many standard errors to count."""
MARGIN = 1e-3
"""A difference must be beyond this share of the mean to count: what is certain may be of no account."""


def agreement(one: Mapping[str, Rows], other: Mapping[str, Rows]) -> dict[str, Any]:
    """Compare how two feeders rank rows by their means over episodes.

    Parameters
    ----------
    one, other
        Groups of rows by name, the same in both; rows are ranked within their group. Episodes are paired.

    Returns
    -------
    ``kendall_tau`` (b) and ``spearman_rho``, means over the groups, None where all rows of a group are alike.
    ``pairs``, their number. ``swapped``, a record of each pair that changes places: ``better`` and ``worse`` on the
    first feeder, ``certain`` if the difference is beyond :data:`STANDARD_ERRORS` and :data:`MARGIN` on both.
    """
    found, swapped, pairs = [], [], 0
    for group, here in one.items():
        there = other[group]
        found.append(correlations(*([float(rows[name].mean()) for name in here] for rows in (here, there))))
        for better, worse in itertools.permutations(here, 2):
            pairs += 1
            gains = [rows[worse] - rows[better] for rows in (here, there)]
            if gains[0].mean() > 0.0 > gains[1].mean():
                certain = all(_counts(gain, rows[better]) for gain, rows in zip(gains, (here, there), strict=True))
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


def _counts(difference: np.ndarray, figure: np.ndarray) -> bool:
    """Whether a paired difference over episodes is beyond chance, and not small relative to the figure itself."""
    error = difference.std(ddof=1) / np.sqrt(len(difference))
    return bool(abs(difference.mean()) > max(STANDARD_ERRORS * error, MARGIN * abs(figure.mean())))


def ranks(values: Sequence[float]) -> list[int]:
    """The place of each value, 1 the lowest; of equal ones the first comes first."""
    order = np.argsort(np.argsort(values, kind="stable"), kind="stable")
    return [int(place) + 1 for place in order]

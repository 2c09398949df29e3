"""A feeder with the ratings of a season and kind."""

from __future__ import annotations

from typing import Any, NamedTuple

from dcgrid_env.grid.folder import AnyFeeder
from dcgrid_env.grid.seasonal_ratings import RatingKind, chosen_ratings


class RatedFeeder(NamedTuple):
    """A feeder whose rating columns contain the ratings of a season and kind."""

    feeder: AnyFeeder
    without: tuple[str, ...]
    """Rated elements without a rating of that season and kind, which keep another one."""


def with_ratings(feeder: AnyFeeder, rating: RatingKind = "normal", season: str = "") -> RatedFeeder:
    """Choose the ratings of a feeder that apply: normal or emergency, and those of a season.

    An element without a normal rating of the season keeps that of its rating column. An element without an emergency
    rating of the season has its emergency rating without season, or else its normal rating.

    Parameters
    ----------
    feeder
        A balanced or three-phase feeder, with ``ratings.csv`` or the table ``rating``.
    rating
        ``normal`` or ``emergency``.
    season
        A season that the feeder has ratings for; empty for the ratings without a season.

    Returns
    -------
    RatedFeeder
        The feeder, and the elements without a rating of that season and kind.

    Raises
    ------
    FeederError
        For a season that no element has, or if no emergency rating is known.

    Examples
    --------
    >>> from dcgrid_env import load_feeder
    >>> with_ratings(load_feeder("ieee33")).without
    ()
    """
    chosen = chosen_ratings(feeder.to_network(), rating, season)
    if rating == "normal" and not season:
        return RatedFeeder(feeder, ())
    kind: Any = type(feeder)
    rated = kind.from_network(chosen.network)
    rated.__dict__["_folder"] = feeder.folder  # its other facts are still those of the files there
    return RatedFeeder(rated, chosen.without)

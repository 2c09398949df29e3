"""Ratings of branches by season and for emergencies: checks of the table, and the choice of those that apply."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterator
from typing import Literal, NamedTuple, get_args

from dcgrid_env.grid.network import Network
from dcgrid_env.grid.three_phase_tables import FALLBACKS, RATINGS
from dcgrid_env.grid.topology import FeederError

RatingKind = Literal["normal", "emergency"]
"""Kinds of a rating: of continuous operation, and of the hours after an outage."""


class ChosenRatings(NamedTuple):
    """Tables with the ratings of a season and kind in their rating columns."""

    network: Network
    without: tuple[str, ...]
    """Rated elements that have no rating of that season and kind, and are checked by another one."""


def chosen_ratings(network: Network, kind: RatingKind = "normal", season: str = "") -> ChosenRatings:
    """Put the ratings of a season and kind into the rating columns of a network.

    An element without a normal rating of the season has that of its rating column. An element without an emergency
    rating of the season has its emergency rating without season, or else its normal rating, which is the safe side.

    Parameters
    ----------
    network
        Checked tables of a feeder.
    kind
        ``normal`` or ``emergency``.
    season
        A season of the table ``rating``; empty for the ratings without a season.

    Raises
    ------
    FeederError
        For an unknown kind, a season that no element has, or emergency ratings if there are none.
    """
    table, where = network.rating, f"feeder {network.name!r}"
    if kind not in get_args(RatingKind):
        raise FeederError(f"{where}: rating is {kind!r}; choose {' or '.join(get_args(RatingKind))}")
    seasons = sorted(set(table.season) - {""})
    if season and season not in seasons:
        known = (
            f"choose {', '.join(seasons)}, or leave it empty"
            if seasons
            else "it is without seasons in ratings.csv; leave it empty"
        )
        raise FeederError(f"{where}: season is {season!r}; {known}")
    if kind == "emergency" and all(map(math.isnan, table.emergency)):
        raise FeederError(f"{where}: rating is 'emergency', but no emergency rating is known; add them in ratings.csv")
    if kind == "normal" and not season:
        return ChosenRatings(network, ())
    names = _spellings(network)
    rows = zip(table.element, table.season, table.normal, table.emergency, strict=True)
    by_key = {(names[element], row_season): (normal, emergency) for element, row_season, normal, emergency in rows}
    changed, without = {}, []
    for name, column, elements in _elements(network):
        rated, values = getattr(network, name), []
        before = getattr(rated, column) or getattr(rated, FALLBACKS[column] or "", ()) or (math.nan,) * len(rated)
        for element, always in zip(elements, before, strict=True):
            unknown = (math.nan, math.nan)
            normal, emergency = by_key.get((element, season), unknown)
            _, any_season = by_key.get((element, ""), unknown)
            wanted = (normal,) if kind == "normal" else (emergency, any_season)
            known = [value for value in (*wanted, normal, always) if not math.isnan(value)]
            values.append(known[0] if known else math.nan)
            if known and math.isnan(wanted[0]):
                without.append(element)
        if not all(map(math.isnan, values)):
            changed[name] = dataclasses.replace(rated, **{column: values})
    return ChosenRatings(dataclasses.replace(network, **changed), tuple(without))


def check_ratings(network: Network) -> None:
    """Raise FeederError for a row of the table ``rating`` that is invalid, naming the element and the field."""
    table, rated, names = network.rating, set[tuple[str, str]](), _spellings(network)
    for element, season, normal, emergency in zip(
        table.element, table.season, table.normal, table.emergency, strict=True
    ):
        where = f"feeder {network.name!r}: rating of {element!r}"
        if element not in names:
            wanted = "'branch FROM-TO' with its buses" if len(network.line) else "a kind and name such as 'line l1'"
            raise FeederError(f"{where}: there is no such element; give {wanted}")
        if (names[element], season) in rated:
            raise FeederError(f"{where}: season {season!r} is there twice; leave one out")
        rated.add((names[element], season))
        for field, value in (("normal", normal), ("emergency", emergency)):
            if not isinstance(value, int | float) or isinstance(value, bool) or value <= 0.0 or math.isinf(value):
                raise FeederError(f"{where}: {field} is {value!r}; give a number > 0, or leave it empty")
        if not season and not math.isnan(normal):
            raise FeederError(f"{where}: normal is {normal!r} without a season; give it in the table of the element")
        if math.isnan(normal) and math.isnan(emergency):
            raise FeederError(f"{where}: normal and emergency are empty; give one, or leave the row out")


def _elements(network: Network) -> Iterator[tuple[str, str, list[str]]]:
    """Table, rating column and names of the rows of each kind of branch."""
    line = network.line
    if len(line):
        yield "line", "rating_a", [f"branch {i}-{j}" for i, j in zip(line.from_bus, line.to_bus, strict=True)]
    for kind, column in RATINGS.items():
        table = getattr(network, kind)
        words = table.kind if kind == "admittance" else (kind.removeprefix("phase_"),) * len(table)
        if len(table):
            yield kind, column, [f"{word} {name}" for word, name in zip(words, table.name, strict=True)]


def _spellings(network: Network) -> dict[str, str]:
    """Name of each element by the texts that mean it: a balanced branch may be named in either direction."""
    spellings = {element: element for _, _, elements in _elements(network) for element in elements}
    line = network.line
    for i, j in zip(line.from_bus, line.to_bus, strict=True):
        spellings.setdefault(f"branch {j}-{i}", f"branch {i}-{j}")
    return spellings

"""Load profiles of a scenario: power of each load, bus or class over time, from a file."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np

from dcgrid_env.core.cache import cached_on_owner
from dcgrid_env.core.checked import FieldError, as_pairs, choice, number, pairs, refuse, settle
from dcgrid_env.core.suggestions import nearest
from dcgrid_env.grid import AnyFeeder, Feeder
from dcgrid_env.traces import WHOLE, ProfileTable, TraceError, read_classes, read_profiles
from dcgrid_env.traces.profile_file import REACTIVE

_SHOWN = 5
MOST_BLOCK_DAYS = 7
"""Longest block of days that the splits take in turn."""
_CYCLE = ("train", "train", "validation", "train", "test")
"""Splits of the blocks of days, in turn."""


@dataclass(frozen=True, kw_only=True)
class LoadProfiles:
    """Power of the loads over time from a file; without a file there are none.

    The time of day of an episode is then that of the file.
    """

    file: ProfileTable | None = None
    """CSV or Parquet file, or a ``ProfileTable`` (``traces.profile_file`` has the forms); None for no profiles."""
    columns: Literal["load", "bus", "class"] = choice("load", "bus", "class", default="load")
    """Meaning of the names of the columns: loads, buses, or classes. A balanced feeder has a load for each bus."""
    classes: tuple[tuple[str, str], ...] | None = pairs(default=None)
    """Class of each load, or of each bus on a balanced feeder: a mapping of names, or a CSV file with the columns load
    and class. Required for columns of classes."""
    unit: Literal["pu", "kw"] = choice("pu", "kw", default="pu")
    """``pu``: shares of the nominal power of the load. ``kw``: kW and kvar of the load or bus in total over its
    phases. Without a column of reactive power, the nominal power factor holds."""
    between: Literal["hold", "linear"] = choice("hold", "linear", default="hold")
    """Values between two samples: a sample holds until the next one, or they are linear in time."""
    days: Literal["split", "all", "repeat"] = choice("split", "all", "repeat", default="split")
    """Days in which episodes lie. ``split``: blocks of days go to train, validation and test in turn, 60, 20 and 20 %,
    and no episode lies in two of them; ood has those of test, and whole has all. ``all``: all days, in each split.
    ``repeat``: all days, and the file begins again after its end."""
    start_h: float | None = number(0.0, 1e9, default=None)
    """Begin of all episodes, h since the midnight before the file's first sample; None for a begin by seed."""
    uncovered: Literal["refuse", "nominal"] = choice("refuse", "nominal", default="refuse")
    """Loads without a profile: an error that names them, or constant nominal power."""

    def __post_init__(self) -> None:
        settle(self, file=_file, classes=_classes)
        if self.file is not None and not isinstance(self.file, ProfileTable):
            raise refuse(self, "file", "give the path of a CSV or Parquet file, a ProfileTable, or None")
        if self.classes is not None and not _are_pairs(self.classes):
            raise refuse(self, "classes", "give a mapping from loads to classes, or a CSV file")
        self._check_others()

    def _check_others(self) -> None:
        if self.file is None:
            for name in ("columns", "classes", "unit", "between", "days", "start_h", "uncovered"):
                if getattr(self, name) != type(self).__dataclass_fields__[name].default:
                    raise refuse(self, name, "give load_profiles.file too, or leave it out")
            return
        if (self.columns == "class") != bool(self.classes):
            remedy = "give the class of each load" if not self.classes else "leave it out, or give columns = 'class'"
            raise refuse(self, "classes", remedy)
        if self.columns == "class" and self.unit == "kw":
            raise refuse(self, "unit", "give 'pu': the power of a class in kW does not define that of its loads")
        if self.days == "repeat" and abs(self.file.duration_h / 24.0 - round(self.file.duration_h / 24.0)) > 1e-9:
            remedy = f"give 'all', or a file of whole days: this one covers {self.file.duration_h:g} h"
            raise refuse(self, "days", remedy)

    @property
    def table(self) -> ProfileTable:
        """The profiles; ValueError without a file."""
        if self.file is None:
            raise ValueError("the scenario has no load profiles; give load_profiles.file")
        return self.file

    def ranges_h(self, split: str) -> list[tuple[float, float]]:
        """Return the begin and end of each range of time in which episodes of a split lie.

        Hours since the midnight before the file's first sample.
        """
        table = self.table
        begin, end = table.begin_h, table.begin_h + table.duration_h
        if self.days != "split" or split == WHOLE:
            return [(begin, end)]
        size, wanted = self.block_days, "test" if split == "ood" else split
        found: list[tuple[float, float]] = []
        for block in range(math.ceil(table.n_days / size)):
            if _CYCLE[block % len(_CYCLE)] != wanted:
                continue
            low, high = max(begin, 24.0 * size * block), min(end, 24.0 * size * (block + 1))
            if found and found[-1][1] == low:
                low = found.pop()[0]
            found.append((low, high))
        return found

    @property
    def block_days(self) -> int:
        """Number of days of a block of ``days = "split"``: a tenth of the file, at least 1 and at most a week."""
        return min(max(self.table.n_days // 10, 1), MOST_BLOCK_DAYS)


def check_load_profiles(scenario: Any) -> None:
    """Raise FieldError if the profiles do not fit the feeder, the split or the length of an episode."""
    profiles = scenario.load_profiles
    if profiles.file is None:
        return
    if not isinstance(scenario.feeder, AnyFeeder):
        remedy = "leave it out: random feeders have other loads in each episode"
        raise FieldError("Scenario", "load_profiles.file", profiles.file.label, remedy)
    hour = scenario.background.start_hour
    if profiles.start_h is not None and hour is not None:
        remedy = "leave it out, or leave load_profiles.start_h out: each sets the begin of an episode"
        raise FieldError("Scenario", "background.start_hour", hour, remedy)
    profile_weights(scenario.feeder, profiles)
    profile_begins_h(scenario)


def profile_begins_h(scenario: Any) -> np.ndarray:
    """Return the earliest and latest begin of an episode in each range of its split, (range, 2).

    Hours since the midnight before the file's first sample. With ``background.start_hour``, each range is one hour of
    one day. FieldError if there is none.
    """
    profiles, length_h = scenario.load_profiles, scenario.horizon * scenario.dt_s / 3600.0
    table, hour, repeats = profiles.table, scenario.background.start_hour, profiles.days == "repeat"
    ranges = profiles.ranges_h(scenario.split)
    fitting = [(low, high if repeats else high - length_h) for low, high in ranges]
    fitting = [(low, max(low, high)) for low, high in fitting if high >= low - 1e-9]
    is_cut = profiles.days == "split" and scenario.split != WHOLE
    where = f"of the split {scenario.split!r} " if is_cut else ""
    if not fitting:
        most = max((high - low for low, high in ranges), default=0.0)
        part = f", {where}at most {most:g} h at a time" if where else ""
        remedy = "days = 'all', which shares days with tests" if where else "days = 'repeat'"
        raise FieldError(
            "Scenario", "load_profiles.file", f"{table.label} with {table.duration_h:g} h{part}",
            f"an episode lasts {length_h:g} h; give a longer file, a shorter episode, or load_profiles.{remedy}",
        )  # fmt: skip
    if profiles.start_h is not None:
        if not any(low - 1e-9 <= profiles.start_h <= high + 1e-9 for low, high in fitting):
            first = ", ".join(f"{low:g} to {high:g}" for low, high in fitting[:_SHOWN])
            remedy = f"give a begin {where}within {first} h" + (", or days = 'all'" if where else "")
            raise FieldError("Scenario", "load_profiles.start_h", profiles.start_h, remedy)
        return np.array([(profiles.start_h, profiles.start_h)])
    if isinstance(hour, int | float):
        days = [24.0 * day + hour for day in range(table.n_days + 1)]
        exact = [(t, t) for t in days if any(low - 1e-9 <= t <= high + 1e-9 for low, high in fitting)]
        if not exact:
            remedy = f"no day {where}has an episode of {length_h:g} h from this hour on; give another"
            raise FieldError("Scenario", "background.start_hour", hour, remedy)
        return np.array(exact)
    return np.array(fitting)


@cached_on_owner
def _targets(feeder: AnyFeeder, by: str) -> dict[str, np.ndarray]:
    """Return the positions of the legs of each load or bus that has any, by its name."""
    if isinstance(feeder, Feeder):
        return {bus: np.array([i]) for i, bus in enumerate(feeder.bus_ids)}
    legs, names = feeder.load_legs, feeder.network.phase_load.name
    found: dict[Any, list[int]] = {name: [] for name in names} if by == "load" else {}
    for leg, (row, bus) in enumerate(zip(legs.row.tolist(), legs.bus.tolist(), strict=True)):
        found.setdefault(feeder.bus_ids[bus] if by == "bus" else names[row], []).append(leg)
    return {name: np.array(positions, np.int64) for name, positions in found.items()}


class ProfileCoverage(NamedTuple):
    """Loads of a feeder that follow a profile, and those that do not."""

    with_profile: int
    """Number of loads, or buses, that follow a profile."""
    without: tuple[str, ...]
    """Names of the loads, or buses, that stay at their nominal power."""

    def __str__(self) -> str:
        text = f"{self.with_profile} loads follow a profile"
        if self.without:
            text += f"; {len(self.without)} have none and stay at their nominal power: {_first(self.without)}"
        return text


class ProfileWeights:
    """How the columns of the profiles become the loads of a feeder.

    Leg ``legs[i]`` draws column ``p_column[i]`` times ``p_weight[i]``, kW, and reactive power in the same way, kvar.
    ``p_rest_kw`` and ``q_rest_kvar`` (n_leg,) are the nominal loads without a profile.
    """

    def __init__(self, feeder: AnyFeeder, profiles: LoadProfiles):
        balanced = isinstance(feeder, Feeder)
        by = "load" if profiles.columns == "class" else profiles.columns
        targets = _targets(feeder, by)
        p_kw, q_kvar = np.array(feeder.p_load_kw), np.array(feeder.q_load_kvar)
        chosen, table = _columns(feeder, profiles, targets), profiles.table
        position = {name: i for i, name in enumerate(table.names)}
        legs, p_column, p_weight, q_column, q_weight = [], [], [], [], []
        for name, column in chosen.items():
            at = targets[name]
            p, q = p_kw[at], q_kvar[at]
            reactive = position.get(column + REACTIVE)
            p_share, q_share = p, q
            if profiles.unit == "kw":
                total_kw, total_kvar = float(p.sum()), float(q.sum())
                p_share = _shares(p, total_kw, balanced)
                if p_share is None:
                    raise _refused(
                        profiles,
                        f"{name!r} in kW",
                        "its nominal load is 0 kW, so it has no phases to scale; give it a load",
                    )
                if reactive is not None:
                    q_share = _shares(q, total_kvar, balanced)
                    q_share = p_share if q_share is None else q_share
                elif total_kw:
                    q_share = q / total_kw
                else:
                    raise _refused(
                        profiles,
                        f"{name!r} in kW",
                        f"its nominal load is 0 kW, so it has no power factor; give a column {column + REACTIVE!r}",
                    )
            legs.append(at)
            p_column += [position[column]] * len(at)
            q_column += [position[column] if reactive is None else reactive] * len(at)
            p_weight.append(p_share)
            q_weight.append(q_share)
        self.legs = np.concatenate(legs)
        self.p_column, self.q_column = np.array(p_column), np.array(q_column)
        self.p_weight, self.q_weight = np.concatenate(p_weight), np.concatenate(q_weight)
        self.p_rest_kw, self.q_rest_kvar = p_kw, q_kvar
        p_kw[self.legs] = q_kvar[self.legs] = 0.0
        without = tuple(name for name, at in targets.items() if np.any(p_kw[at] != 0.0) or np.any(q_kvar[at] != 0.0))
        self.coverage = ProfileCoverage(len(chosen), without)
        if without and profiles.uncovered == "refuse":
            remedy = (
                f"{table.label} has no profile for {len(without)} loads: {_first(without)}; give them one, or "
                "uncovered = 'nominal'"
            )
            raise FieldError("LoadProfiles", "uncovered", profiles.uncovered, remedy)


@cached_on_owner
def profile_weights(feeder: AnyFeeder, profiles: LoadProfiles) -> ProfileWeights:
    """Return how profiles become the loads of a feeder; FieldError for a name that fits no load, bus or class."""
    return ProfileWeights(feeder, profiles)


def profile_coverage(scenario: Any) -> ProfileCoverage:
    """Return the loads of a scenario that follow a profile, and those that do not; ValueError without profiles."""
    _ = scenario.load_profiles.table
    return profile_weights(scenario.feeder, scenario.load_profiles).coverage


def _columns(feeder: AnyFeeder, profiles: LoadProfiles, targets: Mapping[str, np.ndarray]) -> dict[str, str]:
    """Return the column of each load or bus that has a profile."""
    table, by = profiles.table, profiles.columns
    names = set(table.names)
    classes = dict(profiles.classes or ())
    known = set(classes.values()) if by == "class" else set(targets)
    active = [name for name in table.names if name in known]
    for name in table.names:
        of = name.removesuffix(REACTIVE)
        if name in known or (name.endswith(REACTIVE) and of in known and of in names):
            continue
        if by == "class":
            continue  # a file of classes may have more than a feeder uses
        if name.endswith(REACTIVE) and of in known:
            raise _refused(profiles, f"column {name!r}", f"give active power too, in a column {of!r}")
        what = "bus" if by == "bus" or isinstance(feeder, Feeder) else "load"
        remedy = f"feeder {feeder.name!r} has no {what} of this name; {nearest(of, sorted(known), 'check columns')}"
        raise _refused(profiles, f"column {name!r}", remedy)
    if by != "class":
        return {name: name for name in active}
    for load, kind in classes.items():
        if load not in targets:
            what = "bus" if isinstance(feeder, Feeder) else "load"
            remedy = f"feeder {feeder.name!r} has no {what} {load!r}; {nearest(load, sorted(targets), 'leave it out')}"
            raise FieldError("LoadProfiles", "classes", f"{load} = {kind}", remedy)
        if kind not in names:
            there = ", ".join(n for n in table.names if not n.endswith(REACTIVE))
            raise FieldError("LoadProfiles", "classes", f"{load} = {kind}", f"{table.label} has the columns {there}")
    return classes


def _are_pairs(value: object) -> bool:
    are_tuples = isinstance(value, tuple) and len(value) > 0 and all(isinstance(pair, tuple) for pair in value)
    return are_tuples and all(len(pair) == 2 and all(isinstance(text, str) for text in pair) for pair in value)  # pyright: ignore


def _shares(values: np.ndarray, total: float, balanced: bool) -> np.ndarray | None:
    """Return the shares of the legs of a load in its total; None for a total of 0."""
    if balanced:
        return np.ones(1)
    return None if abs(total) <= 1e-9 * float(np.abs(values).sum()) else values / total


def _refused(profiles: LoadProfiles, what: str, remedy: str) -> FieldError:
    return FieldError("LoadProfiles", "file", f"{profiles.table.label}, {what}", remedy)


def _first(names: tuple[str, ...]) -> str:
    more = len(names) - _SHOWN
    return ", ".join(names[:_SHOWN]) + (f" and {more} more" if more > 0 else "")


def _file(value: object) -> Any:
    """Return the table of a file; any other value unchanged."""
    if not isinstance(value, str | Path):
        return value
    try:
        return read_profiles(value)
    except (TraceError, OSError, UnicodeDecodeError) as error:
        raise FieldError("LoadProfiles", "file", str(value), str(error)) from None


def _classes(value: object) -> Any:
    """Return the pairs of a mapping or a file; any other value unchanged."""
    if isinstance(value, str | Path):
        try:
            value = read_classes(value)
        except (TraceError, OSError, UnicodeDecodeError) as error:
            raise FieldError("LoadProfiles", "classes", str(value), str(error)) from None
    return as_pairs({name: str(kind) for name, kind in value.items()} if isinstance(value, Mapping) else value)

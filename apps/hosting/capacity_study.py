"""Define a study of hosting capacity: candidate buses, limits and sampled load.

The *hosting capacity* of a bus is the largest size that can be connected there before a limit of the feeder is broken.
It is found by iteration over sizes, as in California's integration capacity analysis. The streamlined estimates of
EPRI's DRIVE do not apply, since a controlled load has no closed form. Both are compared in "Lessons learned from
performing an integration capacity analysis" (POWER Engineers, CIGRE US National Committee 2018); EPRI report 1026640
(2012) describes the stochastic method.

Load levels are those of all hours of load profiles, or of a standard day. The hours that are worst in a power flow are
always among them (``load_hours``). Each sample is a window of seconds with a separate trace of the site and noise of
the other loads, so that the behaviour of a controller over time counts. With time series a limit can allow a duration,
where a snapshot must take the strictest limit (A. K. Jain, K. Horowitz, F. Ding and others, "Dynamic hosting capacity
analysis for distributed photovoltaic resources", Applied Energy 2020). If a controller may slow work down, the size
alone is not informative, and the delay is reported as well (as G. C. Sarker and N. Dahlin, arXiv 2604.20185, do for
flexible connections).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Literal, get_args

import numpy as np

from dcgrid_env import Feeder, LoadProfiles, RandomFeeders, RatingCoverage, Scenario, rating_coverage
from dcgrid_env.core.seeds import MOST_SAMPLES
from dcgrid_env.grid import RatingKind, with_ratings
from dcgrid_env.traces.day_course import LOAD_PERCENT

Load = Literal["day", "peak"]
SAMPLES = 64
WINDOW_S, SETTLE_S = 60.0, 20.0
MAX_BUSES = 64
"""Maximum number of candidates unless buses are named."""
LARGEST_SHARE = 3.0
"""Default of the largest size that is tried, as a share of the feeder's base load."""
_STEPS = 1000
"""Approximate number of sizes up to the largest, unless the distance between them is given."""
PEAK_HOUR = float(np.argmax(LOAD_PERCENT)) + 0.5
"""Hour of the day at which the other loads are at their peak."""


@dataclass(frozen=True, kw_only=True)
class Study:
    """Settings of a study of hosting capacity.

    Raises
    ------
    ValueError
        If a value is invalid; the message names it and what is allowed.
    """

    scenario: Scenario
    """Scenario that defines the feeder, its source voltage and loads, the trace and kind of the added site, and the
    existing devices."""
    others: bool = True
    """Whether the scenario's devices remain on the feeder; if not, the added site is the only one."""
    buses: tuple[str, ...] | None = None
    """Candidate buses; None for load buses, with three phases on a three-phase feeder. At most ``MAX_BUSES`` are taken,
    spread evenly in the order of the feeder."""
    samples: int = SAMPLES
    """Number of windows of sampled load, with seeds 0, 1, ..; the same for every bus, size and controller. Windows at
    the worst hours are added to them (``windows``)."""
    load: Load = "day"
    """``day``: the begins of the samples are spread evenly over all hours of the load profiles. Without load profiles,
    sample i begins 24 i / samples hours after the peak hour of a standard day; other loads and PV follow the hour.
    ``peak``: all samples are at nominal load and noon."""
    window_s: float = WINDOW_S
    """Length of a window, s."""
    settle_s: float = SETTLE_S
    """Seconds at the beginning of a window in which limits do not count. Controllers begin without reactive power and
    with all clocks at the maximum, which does not occur in continuous operation."""
    v_min_pu: float = 0.95
    v_max_pu: float = 1.05
    """Limits of the voltage at every bus, p.u.; those of ANSI C84.1, range A, for service voltages."""
    loading_max_pct: float = 100.0
    """Limit of a branch's current as a share of its rating, where a rating is known, %."""
    rating: RatingKind = "normal"
    """Ratings that apply: ``normal``, or ``emergency`` of the feeder's ratings.csv."""
    season: str = ""
    """Season of the ratings, such as ``winter`` in ratings.csv; empty for the ratings without a season."""
    outage_rating: RatingKind | None = None
    """Ratings that apply while an element is out of service; None for ``rating``."""
    voltage_step_max_pct: float | None = None
    """Limit of the change of any voltage from one step to the next, % of nominal voltage; None for no limit. Every
    window has a step of the sites to their full rating and back."""
    taps_max_per_hour: float | None = None
    """Limit of the taps of each regulator in a window, per hour; None for no limit."""
    loss_max_kw: float | None = None
    """Limit of the mean loss of a window, kW; None for no limit."""
    allowed_pct: float = 0.0
    """Allowed share of the seconds of all windows, those at the worst hours included, with some bus or branch outside
    its limits, %."""
    tolerance_mw: float | None = None
    """Distance between sizes, MW; a capacity is a multiple of it. None: a round number near 1/1000 of the largest."""
    max_mw: float | None = None
    """Largest size that is tried, MW; None: three times the feeder's base load, rounded."""

    def __post_init__(self) -> None:
        feeder = self.scenario.feeder
        if isinstance(feeder, RandomFeeders):
            raise ValueError(
                f"scenario {self.scenario.name!r} is on random feeders, and capacity is a matter of one; write "
                f"a member, random_feeder(0, n_bus={feeder.n_bus}, style={feeder.style!r}, load_kw={feeder.load_kw:g})"
                ".to_csv('my-feeder'), and study that"
            )
        known = (*get_args(RatingKind), None)
        remedy = f"choose {' or '.join(get_args(RatingKind))}"
        self._require("rating", self.rating in known[:-1], remedy)
        fits = self.outage_rating in known and (self.rating, self.outage_rating) != ("emergency", "normal")
        self._require("outage_rating", fits, f"{remedy}, and not normal if rating is emergency")
        self._require("season", isinstance(self.season, str), "give the name of a season, or leave it empty")
        if self.rating == "emergency" or self.season:
            rated = with_ratings(feeder, self.rating, self.season)
            object.__setattr__(self, "scenario", self.scenario.replace(feeder=rated.feeder))
        fits = isinstance(self.samples, int) and 1 <= self.samples <= MOST_SAMPLES
        self._require("samples", fits, f"give a whole number from 1 to {MOST_SAMPLES:,}")
        self._require("load", self.load in get_args(Load), f"choose one of {', '.join(get_args(Load))}")
        least_s = 2.0 * self.scenario.dt_s
        self._require("window_s", _finite(self.window_s) and self.window_s >= least_s, f"give at least {least_s:g} s")
        self._require("window_s", self.window_s <= 3600.0, "give at most 3600 s")
        settles = _finite(self.settle_s) and 0.0 <= self.settle_s <= self.window_s - self.scenario.dt_s
        self._require("settle_s", settles, f"give 0 to less than the window's {self.window_s:g} s")
        self._require("v_min_pu", _finite(self.v_min_pu) and self.v_min_pu > 0.0, "give a voltage > 0 p.u.")
        above = _finite(self.v_max_pu) and self.v_max_pu > self.v_min_pu
        self._require("v_max_pu", above, f"give a voltage above the lowest, {self.v_min_pu:g} p.u.")
        self._require("loading_max_pct", _finite(self.loading_max_pct) and self.loading_max_pct > 0.0, "give > 0 %")
        allowed = _finite(self.allowed_pct) and 0.0 <= self.allowed_pct < 100.0
        self._require("allowed_pct", allowed, "give a share from 0 to less than 100 %")
        for name, meaning in (
            ("tolerance_mw", "a size > 0 MW"),
            ("max_mw", "a size > 0 MW"),
            ("voltage_step_max_pct", "a change > 0 %"),
            ("taps_max_per_hour", "a number > 0"),
            ("loss_max_kw", "a loss > 0 kW"),
        ):
            value = getattr(self, name)
            self._require(name, value is None or (_finite(value) and value > 0.0), f"give {meaning}, or None")
        regulators = getattr(self.scenario.feeder, "n_regulator", 0)
        taps_fit = self.taps_max_per_hour is None or regulators > 0
        self._require("taps_max_per_hour", taps_fit, "the feeder has no regulators; give None")
        self._require("tolerance_mw", self.step_mw <= self.largest_mw, f"give at most {self.largest_mw:g} MW")
        self._require("tolerance_mw", self.largest_mw / self.step_mw < 1e6, "give fewer than a million sizes")

    def with_outage(self, scenario: Scenario) -> Study:
        """Return the study of a scenario with an element out of service, with the ratings that apply then."""
        return replace(self, scenario=scenario, rating=self.outage_rating or self.rating)

    @property
    def coverage(self) -> RatingCoverage:
        """Elements whose rating is known, with the season and kind of the ratings if one was chosen."""
        feeder = self.scenario.feeder
        basis = "" if (self.rating, self.season) == ("normal", "") else f"{self.season or 'all seasons'}, {self.rating}"
        without = with_ratings(feeder, self.rating, self.season).without
        return rating_coverage(feeder)._replace(basis=basis, otherwise=without)

    def _require(self, field: str, holds: bool, remedy: str) -> None:
        if not holds:
            raise ValueError(f"{field} is {getattr(self, field)!r}; {remedy}")

    @property
    def largest_mw(self) -> float:
        """Largest size that is tried, MW."""
        if self.max_mw is not None:
            return self.max_mw
        load_mw = float(np.abs(self.scenario.feeder.p_load_kw).sum()) / 1000.0
        return _round_up(LARGEST_SHARE * load_mw) if load_mw > 0.0 else 10.0

    @property
    def step_mw(self) -> float:
        """Distance between sizes, MW."""
        return _round_up(self.largest_mw / _STEPS) if self.tolerance_mw is None else self.tolerance_mw

    @property
    def top(self) -> int:
        """Number of sizes; the largest is ``top`` steps."""
        return math.floor(self.largest_mw / self.step_mw + 1e-9)

    @property
    def horizon(self) -> int:
        """Number of steps of a window."""
        return round(self.window_s / self.scenario.dt_s)

    @property
    def settled(self) -> int:
        """Number of steps at the beginning of a window that do not count."""
        return round(self.settle_s / self.scenario.dt_s)

    @property
    def full_load_s(self) -> tuple[float, float]:
        """Begin and end of the period of a window with a demand of the full rating at all sites, s.

        It is the middle third of the steps that count, and at least one step.
        """
        counted = self.horizon - self.settled
        steps = max(1, counted // 3)
        begin = self.settled + (counted - steps) // 2
        return begin * self.scenario.dt_s, (begin + steps) * self.scenario.dt_s

    @property
    def load_words(self) -> str:
        """Level of the other loads, for people."""
        if self.load == "peak":
            return "nominal load"
        return "day load" if self.scenario.load_profiles.file is None else "load profiles"

    @property
    def window_fields(self) -> dict[str, Any]:
        """Fields of a scenario whose episodes are the windows."""
        by_day = self.load == "day" and self.scenario.load_profiles.file is None
        hour = "random" if by_day else None  # load profiles have times of their own
        without = {} if self.load == "day" else {"load_profiles": LoadProfiles()}  # at nominal load
        return {
            **without,
            "horizon": self.horizon,
            "background.start_hour": hour,
            "workload.full_load_s": self.full_load_s,
        }

    def allowed_seconds(self, n: int) -> int:
        """Return the allowed number of steps with broken limits in ``n`` windows."""
        return math.floor(self.allowed_pct / 100.0 * n * (self.horizon - self.settled) + 1e-9)

    def candidates(self) -> np.ndarray:
        """Return the positions in ``bus_ids`` of the candidate buses; raise ValueError for an unsuitable bus."""
        feeder = self.scenario.feeder
        if self.buses is not None:
            return self._named(self.buses)
        fit = np.array([i for i in range(1, feeder.n_bus) if self._unfit(i) is None], dtype=np.int64)
        if not len(fit):
            kind = "" if isinstance(feeder, Feeder) else " of three phases"
            raise ValueError(f"feeder {feeder.name!r} has no load bus{kind}; name the candidates as buses")
        return fit[np.linspace(0, len(fit) - 1, min(MAX_BUSES, len(fit))).round().astype(int)]

    def left_out(self) -> dict[str, str]:
        """Give the reason for each bus that is not a candidate, by its name; empty where the candidates are named."""
        if self.buses is not None:
            return {}
        tried = {0, *self.candidates().tolist()}
        spread = f"beyond the {MAX_BUSES} that are tried: name it as one of buses"
        return {bus: self._unfit(i) or spread for i, bus in enumerate(self.scenario.feeder.bus_ids) if i not in tried}

    def _unfit(self, position: int) -> str | None:
        """Give the reason that excludes a bus; None for a possible candidate."""
        feeder = self.scenario.feeder
        if not self._loaded[position]:
            return "without load"
        phases = "abc" if isinstance(feeder, Feeder) else feeder.bus_phases[position]
        return {1: "of one phase", 2: "of two phases"}.get(len(phases))

    @cached_property
    def _loaded(self) -> np.ndarray:
        """Whether each bus has a load."""
        feeder = self.scenario.feeder
        of_legs = feeder.p_load_kw > 0
        return of_legs if isinstance(feeder, Feeder) else np.isin(np.arange(feeder.n_bus), feeder.leg_bus[of_legs])

    def _named(self, buses: Sequence[str]) -> np.ndarray:
        feeder = self.scenario.feeder
        if not buses:
            raise ValueError("buses is empty; name at least one, or leave it out for the load buses")
        positions = [feeder.index(bus) for bus in buses]
        if 0 in positions:
            raise ValueError(
                f"buses has the substation {buses[positions.index(0)]!r}, where the source is; choose another"
            )
        return np.array(list(dict.fromkeys(positions)), dtype=np.int64)


def _finite(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)


def _round_up(value: float) -> float:
    """Round up to the next number of the series 1, 2, 5, 10, .."""
    scale = 10.0 ** math.floor(math.log10(value))
    return next(float(f"{step * scale:.6g}") for step in (1.0, 2.0, 5.0, 10.0) if step * scale >= value * (1 - 1e-9))
